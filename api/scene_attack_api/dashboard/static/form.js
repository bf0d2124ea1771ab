// Makes the fields of a request from its JSON schema. The request is the only state: a field shows a part of it.
import { pictureField } from "./picture.js";
import { at, fieldOf, put, read, resolved, written } from "./schema.js";

// The fields that are shown at once, by path; those of an object that is not listed here are all shown.
const FIRST = {
  "": ["scene", "target", "goal", "attack", "seed"],
  scene: ["objects"],
  "scene.objects.*": ["mesh", "material", "color"],
  target: ["name", "ask"],
  goal: ["truth", "leave", "reach"],
  attack: ["renderer", "groups", "method", "steps", "queries"],
};
// The settings of an attack that mean the same with another renderer or method; all others are left out then.
const KEPT = { renderer: ["steps", "queries", "seconds"], method: ["renderer", "groups", "base_renderer", "steps", "queries", "seconds"] };
const OPEN = ["", "scene", "scene.objects.*", "target", "target.ask", "goal", "attack"];
// The lists of names for fields that are texts in the schema.
const NAMES = {
  "scene.objects.*.mesh": "meshes",
  "scene.objects.*.material": "materials",
  "scene.floor.material": "materials",
  "scene.lights.environment.map": "environments",
  "target.name": "targets",
};

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== undefined && value !== false) made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children);
  return made;
}

const words = (name) => name.replaceAll("_", " ");
// A description: what stands between backticks is code.
const prose = (text) => text.split("`").map((part, k) => (k % 2 ? element("code", {}, part) : part));
const general = (path) => path.map((key) => (typeof key === "number" ? "*" : key)).join(".");

export class Fields {
  // `changed` is called after a field has changed the request; `known` is the answer of /new/choices.json.
  constructor(root, known, changed) {
    this.root = root;
    this.known = known;
    this.defs = known.schema.$defs;
    this.changed = changed;
    this.filled = {};
    const lists = ["meshes", "environments", "targets", "materials"];
    root.after(
      ...lists.map((name) =>
        element("datalist", { id: `names-${name}` }, ...known[name].map(([value, label]) => element("option", { value, label }))),
      ),
    );
  }

  // Shows a request. What is open and focused stays so.
  show(spec) {
    this.spec = spec;
    const open = new Map([...this.root.querySelectorAll("details[id]")].map((one) => [one.id, one.open]));
    const focused = this.root.contains(document.activeElement) ? document.activeElement.id : "";
    this.root.replaceChildren(...this.object(this.known.schema, []));
    for (const [id, was] of open) document.getElementById(id)?.toggleAttribute("open", was);
    if (focused) document.getElementById(focused)?.focus();
  }

  // Shows the values of a filled-in request where fields are left empty.
  fill(filled) {
    this.filled = filled;
    for (const input of this.root.querySelectorAll("[data-path]")) this.placehold(input);
  }

  placehold(input) {
    const value = at(this.filled, JSON.parse(input.dataset.path));
    if (input.type === "checkbox") {
      if ("unset" in input.dataset) input.checked = value ?? input.dataset.default === "true";
    } else if (input.tagName === "SELECT") input.options[0].textContent = !input.value && value ? `default: ${value}` : "default";
    else input.placeholder = written(value ?? undefined, input.dataset.kind);
  }

  set(path, value, rebuild = false) {
    put(this.spec, path, value);
    if (rebuild) this.show(this.spec);
    this.changed();
  }

  keep(names) {
    const attack = Object.entries(this.spec.attack ?? {});
    this.spec.attack = Object.fromEntries(attack.filter(([name]) => names.includes(name)));
  }

  // The fields of an object: the first ones, and the others folded.
  object(schema, path) {
    const place = general(path);
    const names = Object.keys(schema.properties);
    const first = (FIRST[place] ?? names).filter((name) => names.includes(name));
    const rest = names.filter((name) => !first.includes(name));
    const made = first.map((name) => this.field(name, schema.properties[name], [...path, name]));
    if (!rest.length) return made;
    const folded = rest.map((name) => this.field(name, schema.properties[name], [...path, name]));
    const of = path.length ? `More of ${words(String(path.at(-1)))}` : "More";
    const title = place === "scene" ? "Camera, lights, floor, shadows, background" : place.endsWith("*") ? "Pose and surface" : of;
    const id = `more-${path.join(".")}`;
    return [...made, element("details", { id }, element("summary", {}, title), ...folded)];
  }

  field(name, given, path) {
    const place = general(path);
    if (place === "attack") return this.attack(path);
    const { kind, schema, optional } = fieldOf(given, this.defs);
    if (kind === "object") return this.group(name, schema, path, optional);
    if (kind === "list") return this.list(name, schema, path);
    if (place === "attack.groups") return this.groups(path);
    if (kind === "tuple") return this.tuple(name, schema, path);
    if (place === "scene.background.image") return this.picture(name, schema, path);
    return this.single(name, schema, path, kind);
  }

  group(name, schema, path, optional) {
    const id = `f-${path.join(".")}`;
    const given = at(this.spec, path);
    const summary = element("summary", {}, words(name));
    const inside = [];
    if (optional) {
      const has = given !== undefined && given !== null;
      const box = element("input", { type: "checkbox", id: `${id}-has`, checked: has });
      box.addEventListener("change", () => this.set(path, box.checked ? {} : undefined, true));
      inside.push(element("p", { class: "check" }, box, element("label", { for: box.id }, `with ${words(name)}`), this.hint(schema, id)));
      if (has) inside.push(...this.object(schema, path));
    } else inside.push(...this.object(schema, path));
    const error = this.error(id);
    if (OPEN.includes(general(path))) {
      return element("fieldset", { id }, element("legend", {}, words(name)), error, ...inside);
    }
    return element("details", { id, open: inside.length > 1 && optional }, summary, error, ...inside);
  }

  list(name, schema, path) {
    const id = `f-${path.join(".")}`;
    const items = resolved(schema.items, this.defs);
    const given = at(this.spec, path) ?? at(this.filled, path) ?? schema.default ?? [];
    const one = words(name).replace(/s$/, "");
    const made = given.map((_, k) => {
      const remove = element("button", { type: "button", class: "plain small" }, `Remove ${one} ${k + 1}`);
      remove.addEventListener("click", () => {
        this.set(path, given.filter((_, at) => at !== k), true);
        document.getElementById(`${id}-add`).focus();
      });
      const only = given.length <= (schema.minItems ?? 0);
      const own = `f-${[...path, k].join(".")}`;
      const fields = this.object(items, [...path, k]);
      return element("fieldset", { id: own }, element("legend", {}, `${one} ${k + 1}`), this.error(own), ...fields, ...(only ? [] : [remove]));
    });
    const add = element("button", { type: "button", class: "plain small", id: `${id}-add` }, `Add ${one}`);
    add.addEventListener("click", () => {
      this.set(path, [...given, path.at(-1) === "objects" ? { ...given.at(-1) } : {}], true);
      document.getElementById(`f-${[...path, given.length].join(".")}`).querySelector("input, select").focus();
    });
    const full = given.length >= (schema.maxItems ?? Infinity);
    return element("div", { id, class: "list" }, this.error(id), ...made, ...(full ? [] : [add]));
  }

  attack(path) {
    const union = this.known.schema.properties.attack;
    const renderer = at(this.spec, ["attack", "renderer"]) ?? "torch";
    const method = at(this.spec, ["attack", "method"]) ?? this.known.renderers[renderer]?.method;
    const reference = union.discriminator.mapping[method] ?? Object.values(union.discriminator.mapping)[0];
    const schema = resolved({ $ref: reference }, this.defs);
    const methods = { type: "string", enum: this.known.methods, description: schema.description };
    return this.group("attack", { ...schema, properties: { ...schema.properties, method: methods } }, path, false);
  }

  groups(path) {
    const renderer = at(this.spec, ["attack", "renderer"]) ?? "torch";
    const all = this.known.renderers[renderer]?.groups ?? [];
    const given = at(this.spec, path);
    const chosen = Array.isArray(given) && given.length ? given : all.filter((one) => one[2]).map((one) => one[0]);
    const id = `f-${path.join(".")}`;
    const boxes = all.map(([name, said]) => {
      const box = element("input", { type: "checkbox", id: `${id}-${name}`, value: name, checked: chosen.includes(name) });
      box.addEventListener("change", () => {
        const now = [...field.querySelectorAll("input:checked")].map((one) => one.value);
        this.set(path, now.length ? now : undefined, !now.length);
      });
      return element("span", { class: "check" }, box, element("label", { for: box.id, title: said }, words(name)));
    });
    const field = element("fieldset", { id, class: "inline" }, element("legend", {}, "groups"), ...boxes, this.error(id));
    return field;
  }

  tuple(name, schema, path) {
    const id = `f-${path.join(".")}`;
    const inputs = schema.prefixItems.map((_, k) => {
      const input = element("input", { inputmode: "decimal", id: `${id}.${k}`, "aria-label": `${words(name)} ${k + 1}`, "data-path": JSON.stringify([...path, k]), "data-kind": "number", autocomplete: "off" });
      input.value = written(at(this.spec, [...path, k]), "number");
      input.addEventListener("input", () => {
        const texts = inputs.map((one) => one.value);
        const rest = at(this.filled, path) ?? schema.default ?? [];
        const all = texts.map((text, at) => read(text, "number") ?? rest[at] ?? 0);
        this.set(path, texts.every((text) => !text.trim()) ? undefined : all);
      });
      this.placehold(input);
      return input;
    });
    return element("fieldset", { id, class: "inline" }, element("legend", {}, words(name)), ...inputs, this.hint(schema, id), this.error(id));
  }

  picture(name, schema, path) {
    const id = `f-${path.join(".")}`;
    const camera = (of) => at(of, ["scene", "camera", "size"]);
    const size = () => camera(this.spec) ?? camera(this.filled) ?? this.defs.Camera.properties.size.default;
    const made = pictureField(id, words(name), at(this.spec, path), size, (picture) => this.set(path, picture, true));
    return element("div", { class: "field" }, ...made, this.hint(schema, id), this.error(id));
  }

  single(name, schema, path, kind) {
    const id = `f-${path.join(".")}`;
    const list = NAMES[general(path)];
    const value = at(this.spec, path);
    const common = { id, "data-path": JSON.stringify(path), "data-kind": kind, "aria-describedby": `${id}-hint` };
    const rebuild = ["attack.renderer", "attack.method"].includes(general(path));
    let input;
    if (kind === "choice") {
      const none = element("option", { value: "" }, "default");
      const chosen = written(value, kind);
      const names = !chosen || schema.enum.includes(chosen) ? schema.enum : [...schema.enum, chosen]; // a wrong one of the JSON
      input = element("select", common, none, ...names.map((one) => element("option", { value: one, selected: one === chosen }, one)));
    } else if (kind === "check") {
      input = element("input", { ...common, type: "checkbox", checked: value ?? schema.default, "data-unset": value === undefined, "data-default": String(schema.default ?? false) });
    } else {
      const numeric = kind === "number" ? { inputmode: "decimal" } : {};
      input = element("input", { ...common, ...numeric, list: list && `names-${list}`, autocomplete: "off", spellcheck: "false" });
      input.value = written(value, kind);
    }
    input.addEventListener(kind === "choice" || kind === "check" ? "change" : "input", () => {
      if (rebuild) this.keep(KEPT[path.at(-1)]);
      if (kind === "check") input.removeAttribute("data-unset");
      this.set(path, kind === "check" ? input.checked : read(input.value, kind), rebuild);
    });
    this.placehold(input);
    const label = element("label", { for: id }, words(name));
    const parts = kind === "check" ? [input, label] : [label, input];
    return element("div", { class: kind === "check" ? "field check" : "field" }, ...parts, this.hint(schema, id), this.error(id));
  }

  hint(schema, id) {
    return element("small", { class: "hint", id: `${id}-hint` }, ...prose(schema.description ?? ""));
  }

  error(id) {
    return element("span", { class: "error", id: `${id}-error`, hidden: true });
  }
}
