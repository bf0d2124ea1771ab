// Shows the image of a request's scene, the network's first answers, the warnings, and on demand the plan and its cost.
const PAUSE = 150; // milliseconds from a change to its preview, so that changes which come together are one
const shown = document.getElementById("preview");
const state = document.getElementById("preview-state");
const picture = document.getElementById("picture");

let latest; // the newest request that is not asked for yet: [ask, found]
let following = false;

// Shows the preview of a request soon, for whose answer `ask` asks. Of requests that come while one is drawn, only the
// newest is drawn next. Calls `found` with the answer or the errors, but not for a request that was changed meanwhile.
// Until then, the image is marked as that of an earlier request, and its answers are hidden.
export function preview(ask, found) {
  latest = [ask, found];
  shown.hidden = false;
  shown.setAttribute("aria-busy", "true");
  shown.classList.add("stale");
  picture.setAttribute("aria-label", "The image of an earlier scene");
  state.textContent = "Drawing …";
  document.getElementById("cost").replaceChildren();
  if (!following) follow();
}

async function follow() {
  following = true;
  while (latest) {
    await new Promise((resume) => setTimeout(resume, PAUSE));
    const [ask, found] = latest;
    latest = undefined;
    try {
      const { ok, answer } = await ask();
      if (ok) await draw(answer.png); // also when there is a newer request, so that a dragged camera is seen to turn
      if (latest) continue;
      if (ok) tell(answer);
      else state.textContent = answer.errors?.length ? "This request cannot run; the image is that of an earlier one." : answer.detail;
      found(answer, ok);
    } catch {
      state.textContent = "The service does not answer.";
    }
  }
  following = false;
  shown.removeAttribute("aria-busy");
}

async function draw(png) {
  const bytes = Uint8Array.from(atob(png), (one) => one.charCodeAt(0));
  const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
  picture.width = image.width;
  picture.height = image.height;
  picture.getContext("2d").drawImage(image, 0, 0);
}

function tell(found) {
  const [first] = found.answers;
  shown.classList.remove("stale");
  picture.setAttribute("aria-label", `The image of the scene, ${picture.width}×${picture.height} pixels; the network says ${first.answer.label}`);
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

// Shows the plan of a request with its cost, for which `ask` asks.
export async function plan(ask) {
  const cost = document.getElementById("cost");
  cost.replaceChildren(made("p", "Planning …"));
  try {
    const { ok, answer } = await ask();
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
