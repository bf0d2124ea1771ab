// Renders an asset from eight sides by previews, one after the other, each with the network's answer.
"use strict";

const VIEWS = 8;
const SIZE = 224;
const part = document.getElementById("turntable");

function spec(azimuth) {
  return {
    scene: { objects: [{ mesh: part.dataset.mesh }], camera: { azimuth, size: [SIZE, SIZE] } },
    attack: { renderer: "image", base_renderer: "pyrender", steps: 1 },
  };
}

async function draw(canvas, png) {
  const bytes = Uint8Array.from(atob(png), (c) => c.charCodeAt(0));
  const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
  canvas.width = image.width;
  canvas.height = image.height;
  canvas.getContext("2d").drawImage(image, 0, 0);
}

async function view(azimuth) {
  const response = await fetch("/v1/preview", {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(spec(azimuth)),
  });
  const said = await response.json();
  if (!response.ok) throw new Error(said.detail ?? `the service answered ${response.status}`);
  return said;
}

function line(shown, azimuth) {
  const degrees = Math.round((azimuth * 180) / Math.PI);
  const [label, confidence] = shown.answers[0].answer.top[0];
  const item = document.createElement("li");
  const canvas = document.createElement("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `the asset at azimuth ${degrees}°`);
  const text = document.createElement("p");
  text.textContent = `${degrees}° · ${shown.spec.target.name} says ${label} (${(100 * confidence).toFixed(1)} %)`;
  item.append(canvas, text);
  return [item, canvas];
}

async function turn() {
  const [button, status, strip] = ["button", "[role=status]", ".strip"].map((one) => part.querySelector(one));
  button.disabled = true;
  strip.replaceChildren();
  try {
    for (let k = 0; k < VIEWS; k++) {
      status.textContent = `rendering view ${k + 1} of ${VIEWS}`;
      const azimuth = (2 * Math.PI * k) / VIEWS;
      const shown = await view(azimuth);
      const [item, canvas] = line(shown, azimuth);
      await draw(canvas, shown.png);
      strip.append(item);
    }
    status.textContent = `${VIEWS} views, 45° apart`;
  } catch (error) {
    status.textContent = error.message;
  }
  button.disabled = false;
}

if (part) {
  part.hidden = false;
  part.querySelector("button").addEventListener("click", turn);
}
