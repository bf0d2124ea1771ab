// The page "New job": fields, picture and JSON show the same request; whichever is changed changes the others.
import { Fields } from "./form.js";
import { Orbit } from "./orbit.js";
import { plan, preview } from "./preview.js";
import { at, parsed, put } from "./schema.js";
import { busy } from "./submitting.js";

const form = document.getElementById("new");
const text = document.getElementById("spec");
const wrongText = document.getElementById("spec-error");
const problems = document.getElementById("problems");
const root = document.getElementById("fields");
const page = document.querySelector(".new");

const EMPTY = { field: "attack.groups", detail: "choose at least one group" };
const known = await (await fetch("/new/choices.json")).json();
const fields = new Fields(root, document.getElementById("orbit"), known, fromFields);
document.getElementById("raw").classList.add("with-fields");
const CAMERA = ["azimuth", "elevation", "distance"];
const { properties } = known.schema.$defs.Camera;
const orbit = new Orbit(
  document.getElementById("picture"),
  Object.fromEntries(CAMERA.map((name) => [name, properties[name].default])),
  fromOrbit,
);

// The camera has been turned: its settings change with it.
function fromOrbit() {
  orbit.view.azimuth -= 2 * Math.PI * Math.round(orbit.view.azimuth / (2 * Math.PI)); // from -180° to 180°
  for (const name of CAMERA) put(fields.spec, ["scene", "camera", name], Number(orbit.view[name].toFixed(3)));
  fields.display();
  fromFields();
}

function aim() {
  for (const name of CAMERA) {
    const value = fields.value(["scene", "camera", name], properties[name]);
    if (typeof value === "number") orbit.view[name] = value;
  }
}

function fromFields() {
  text.value = JSON.stringify(fields.spec, null, 1);
  wrongText.hidden = true;
  look();
}

function fromText() {
  let spec;
  try {
    spec = parsed(text.value);
    if (spec === null || typeof spec !== "object" || Array.isArray(spec)) throw new Error("a request is an object: { … }");
  } catch (error) {
    wrongText.textContent = `This is not the JSON of a request: ${error.message}`;
    wrongText.hidden = false;
    text.setAttribute("aria-invalid", "true");
    return;
  }
  wrongText.hidden = true;
  text.removeAttribute("aria-invalid");
  fields.show(spec);
  root.hidden = false;
  look();
}

function look() {
  problems.hidden = true;
  aim();
  const request = text.value;
  preview(() => ask("/v1/preview", request), (answer, ok) => {
    clear();
    if (ok) {
      fields.fill(answer.spec);
      aim();
    } else point(answer.errors ?? []);
  });
}

// The service's answer to a request. To the service, an empty list of groups means the renderer's own; here it is an error.
async function ask(url, request = text.value) {
  if (at(fields.spec, ["attack", "groups"])?.length === 0) return { ok: false, answer: { detail: EMPTY.detail, errors: [EMPTY] } };
  const headers = { "Content-Type": "application/json", Accept: "application/json" };
  const response = await fetch(url, { method: "POST", headers, body: request });
  return { ok: response.ok, answer: await response.json() };
}

function clear() {
  for (const one of page.querySelectorAll("span.error")) one.textContent = "";
  for (const one of page.querySelectorAll(":is(#fields, #orbit) [aria-invalid]")) one.removeAttribute("aria-invalid");
}

// Shows each error at its field, or at the nearest one around it; returns those that have none, and the fields.
function point(errors) {
  const placed = [];
  for (const error of errors) {
    const parts = error.field.split(".");
    while (parts.length && !document.getElementById(`f-${parts.join(".")}`)) parts.pop();
    const field = parts.length ? document.getElementById(`f-${parts.join(".")}`) : null;
    const message = nearest(parts);
    if (!message) continue;
    const said = message.id === `f-${error.field}-error` ? error.detail : `${error.field}: ${error.detail}`;
    message.append(message.textContent && "; ", said);
    if (field.matches("input, select, textarea")) {
      field.setAttribute("aria-invalid", "true");
      field.setAttribute("aria-describedby", `${message.id.replace(/-error$/, "-hint")} ${message.id}`);
    }
    for (let fold = field.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
    placed.push({ error, field });
  }
  return placed;
}

// The place of the message of a field: a number of a vector has that of the vector.
function nearest(parts) {
  for (let length = parts.length; length; length--) {
    const found = document.getElementById(`f-${parts.slice(0, length).join(".")}-error`);
    if (found) return found;
  }
  return null;
}

// Lists all errors above the form, each with a link to its field.
function summarise(answer) {
  const errors = answer.errors?.length ? answer.errors : [{ field: "", detail: answer.detail }];
  const placed = new Map(point(errors).map((one) => [one.error, one.field]));
  const lines = errors.map((error) => {
    const line = document.createElement("li");
    const field = placed.get(error);
    const name = document.createElement(field ? "a" : "code");
    name.textContent = error.field;
    if (field) name.href = `#${field.id}`;
    line.append(name, error.field ? ": " : "", error.detail);
    return line;
  });
  problems.querySelector("ul").replaceChildren(...lines);
  problems.hidden = false;
  problems.focus();
  return placed;
}

form.addEventListener("submit", async (event) => {
  event.preventDefault();
  const ready = busy(form, event.submitter);
  try {
    const { ok, answer } = await ask("/v1/jobs");
    if (ok) return location.assign(`/jobs/${answer.id}`);
    clear();
    summarise(answer);
  } catch {
    summarise({ detail: "The service does not answer; nothing was submitted." });
  }
  ready();
});
text.addEventListener("input", fromText);
document.getElementById("plan").addEventListener("click", () => plan(() => ask("/v1/preview?plan=true")));
fromText();
