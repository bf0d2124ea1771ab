// Shows the image of a request's scene, the network's first answers, the warnings, and on demand the plan and its cost.
const PAUSE = 150; // milliseconds from a change to its preview, so that changes which come together are one
const shown = document.getElementById("preview");
const state = document.getElementById("preview-state");
const picture = document.getElementById("picture");

let latest; // the newest request that is not asked for yet: [text, found]
let following = false;

export async function ask(url, body) {
  const headers = { "Content-Type": "application/json", Accept: "application/json" };
  const response = await fetch(url, { method: "POST", headers, body });
  return { ok: response.ok, answer: await response.json() };
}

// Shows the preview of a request soon. Of requests that come while one is drawn, only the newest is drawn next. Calls
// `found` with the answer or the errors, but not for a request that was changed meanwhile.
export function preview(text, found) {
  latest = [text, found];
  shown.hidden = false;
  shown.setAttribute("aria-busy", "true");
  state.textContent ||= "Rendering …";
  if (!following) follow();
}

async function follow() {
  following = true;
  while (latest) {
    await new Promise((resume) => setTimeout(resume, PAUSE));
    const [text, found] = latest;
    latest = undefined;
    document.getElementById("cost").replaceChildren();
    try {
      const { ok, answer } = await ask("/v1/preview", text);
      if (ok) await show(answer);
      else if (!latest) state.textContent = answer.errors?.length ? "This request cannot run; the last image and answers stay." : answer.detail;
      shown.classList.toggle("stale", !ok);
      if (!latest) found(answer, ok);
    } catch {
      state.textContent = "The service does not answer.";
    }
  }
  following = false;
  shown.removeAttribute("aria-busy");
}

async function show(found) {
  const bytes = Uint8Array.from(atob(found.png), (one) => one.charCodeAt(0));
  const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
  picture.width = image.width;
  picture.height = image.height;
  picture.getContext("2d").drawImage(image, 0, 0);
  const [first] = found.answers;
  picture.setAttribute("aria-label", `The image of the scene, ${image.width}×${image.height} pixels; the network says ${first.answer.label}`);
  state.textContent = `The network says “${first.answer.label}” before the attack.`;
  document.getElementById("answers").replaceChildren(...found.answers.map(table));
  const warnings = document.getElementById("warnings");
  warnings.replaceChildren(...found.warnings.map((one) => made("li", one.text)));
  warnings.hidden = !found.warnings.length;
}

function made(tag, text) {
  const element = document.createElement(tag);
  element.textContent = text;
  return element;
}

function table({ asked, answer }) {
  const found = document.createElement("table");
  found.className = "answers";
  const caption = made("caption", asked ?? "The five most probable labels");
  if (!asked) caption.className = "sr";
  found.append(caption);
  for (const [label, probability] of answer.top) {
    const row = found.insertRow();
    const head = made("th", label);
    head.scope = "row";
    const meter = document.createElement("meter");
    meter.value = probability;
    meter.setAttribute("aria-label", label);
    const cell = document.createElement("td");
    cell.append(meter, " ", made("span", `${(100 * probability).toFixed(1)} %`));
    row.append(head, cell);
  }
  return found;
}

// Asks for the plan of a request, and shows it with its cost.
export async function plan(text) {
  const cost = document.getElementById("cost");
  cost.replaceChildren(made("p", "Planning …"));
  try {
    const { ok, answer } = await ask("/v1/preview?plan=true", text);
    cost.replaceChildren(...(ok ? costs(answer) : [made("p", answer.detail)]));
  } catch {
    cost.replaceChildren(made("p", "The service does not answer."));
  }
  cost.scrollIntoView({ block: "nearest" });
}

function costs({ plan, cost }) {
  const limit = cost.queries === null ? "" : `, at most ${cost.queries} queries`;
  const seconds = (value) => (value < 1 ? `${Number((1000 * value).toPrecision(2))} ms` : `${Number(value.toPrecision(2))} s`);
  const list = document.createElement("ul");
  for (const stage of plan.stages) list.append(made("li", `${stage.part} ${stage.name}: ${stage.method}, ${stage.when}`.trim()));
  return [
    made("p", `Up to ${cost.steps} steps${limit}. An image takes ${seconds(cost.image_seconds)}, a query ${seconds(cost.query_seconds)}: at least ${seconds(cost.least_seconds)} in all, and gradients besides.`),
    made("p", `${plan.renderer}: ${plan.groups.join(", ")}; estimated error ${plan.error.toExponential(1)} of a displayed value.`),
    list,
  ];
}
