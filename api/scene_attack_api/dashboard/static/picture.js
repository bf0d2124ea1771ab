// A field for a picture of a request: a file is chosen, fitted to the image of the camera, and put into the request in base64.
const MOST = 400_000; // characters, as the service takes
const KINDS = [["image/png"], ["image/webp", 0.95], ["image/jpeg", 0.9], ["image/jpeg", 0.6]];

// The label, chooser and state of the field. `size` gives height and width of the camera's image; `chosen` is called with
// the picture in base64, or with undefined when it is taken away.
export function pictureField(id, name, value, size, chosen) {
  const input = document.createElement("input");
  Object.assign(input, { type: "file", id, accept: "image/png,image/jpeg,image/webp" });
  input.setAttribute("aria-describedby", `${id}-hint ${id}-state`);
  const label = document.createElement("label");
  Object.assign(label, { htmlFor: id, textContent: name });
  const state = document.createElement("small");
  Object.assign(state, { id: `${id}-state`, className: "hint" });
  state.setAttribute("role", "status");
  state.textContent = value ? `A picture of ${Math.ceil((value.length * 3) / 4000)} kB is behind the objects.` : "No picture: the environment map is shown.";
  input.addEventListener("change", async () => {
    const [file] = input.files;
    if (!file) return;
    state.textContent = "Reading the picture …";
    try {
      chosen(await fitted(file, size()));
    } catch (error) {
      input.value = "";
      state.textContent = `This picture cannot be taken: ${error.message}`;
    }
  });
  if (!value) return [label, input, state];
  const remove = document.createElement("button");
  Object.assign(remove, { type: "button", className: "plain small", textContent: "Remove the picture" });
  remove.addEventListener("click", () => chosen(undefined));
  return [label, input, state, remove];
}

// The file itself if it has the size of the camera's image, else as much of its middle as has that shape, scaled.
async function fitted(file, [height, width]) {
  const image = await createImageBitmap(file).catch(() => {
    throw new Error("it is no PNG, JPEG or WebP file, or it is damaged.");
  });
  if (image.width === width && image.height === height) {
    const whole = await base64(file);
    if (whole.length <= MOST) return whole;
  }
  const canvas = new OffscreenCanvas(width, height);
  const scale = Math.max(width / image.width, height / image.height);
  const [across, down] = [image.width * scale, image.height * scale];
  const context = canvas.getContext("2d");
  context.imageSmoothingQuality = "high";
  context.drawImage(image, (width - across) / 2, (height - down) / 2, across, down);
  for (const [type, quality] of KINDS) {
    const text = await base64(await canvas.convertToBlob({ type, quality }));
    if (text.length <= MOST) return text;
  }
  throw new Error(`in the camera's ${width}×${height} pixels it has more than ${MOST.toLocaleString("en")} characters.`);
}

async function base64(blob) {
  const bytes = new Uint8Array(await blob.arrayBuffer());
  let text = "";
  for (let at = 0; at < bytes.length; at += 0x8000) text += String.fromCharCode(...bytes.subarray(at, at + 0x8000));
  return btoa(text);
}
