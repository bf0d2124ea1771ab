// Makes the fields of a request from its JSON schema. The request is the only state: a field shows a part of it.
import { element } from "./element.js";
import { meshPicker } from "./mesh_picker.js";
import { pictureField } from "./picture.js";
import { at, fieldOf, put, read, resolved, written } from "./schema.js";

// The fields that are shown at once, by path; those of an object that is not listed here are all shown.
const FIRST = {
  "": ["scene", "target", "attack", "goal", "seed"],
  scene: ["objects"],
  "scene.objects.*": ["mesh", "material"],
  target: ["name", "ask"],
  goal: ["truth", "leave", "reach"],
  attack: ["renderer", "groups", "method", "steps", "expectation"],
};
// The settings of an attack that mean the same with another renderer or method; all others are left out then.
const KEPT = { renderer: ["renderer", "steps", "queries", "seconds"], method: ["method", "renderer", "groups", "base_renderer", "steps", "queries", "seconds"] };
const OPEN = ["", "scene", "scene.objects.*", "target", "target.ask", "goal", "attack"];
const TITLES = { scene: "Camera, lights, floor, shadows, background", "scene.objects.*": "Colour, pose and surface" };
const LEGENDS = {
  target: "target: the network",
  attack: "attack: what may change, and how",
  expectation: "expectation: views, light and cameras over which it should hold",
};
// The camera's settings that stand beside the preview, where it is turned.
const ORBIT = ["azimuth", "elevation", "distance"];
// The numbers of a vector; those of one that is not listed here are x, y and z.
const RGB = ["red", "green", "blue"];
const AXES = { color: RGB, ground: RGB, size: ["height", "width"] };
// The ranges of an expectation that only some renderers can draw.
const VARIED = ["azimuth", "elevation", "roll", "distance", "intensity"];
// Fields that have a slider: what it covers, in the unit that is shown, of which the request has `of` each.
const DEGREE = Math.PI / 180;
const SLIDERS = {
  "scene.camera.azimuth": { low: -180, high: 180, unit: "°", of: DEGREE, hint: "around the object, from +z towards +x" },
  "scene.camera.elevation": { low: -90, high: 90, unit: "°", of: DEGREE, hint: "above the horizon; the paper's is 20°" },
  "scene.camera.distance": { low: 0.5, high: 10, step: 0.05, unit: "units", of: 1, hint: "from the middle of the scene; the paper's is 1.8" },
  "scene.camera.roll": { low: -180, high: 180, unit: "°", of: DEGREE, hint: "about the line of sight; the image turns clockwise" },
  "scene.camera.field_of_view": { low: 5, high: 120, unit: "°", of: DEGREE, hint: "from the lower to the upper edge of the image" },
  "attack.expectation.azimuth": { low: 0, high: 180, unit: "± °", of: 1, hint: "of the camera's azimuth" },
  "attack.expectation.elevation": { low: 0, high: 90, unit: "± °", of: 1, hint: "of the camera's elevation" },
  "attack.expectation.roll": { low: 0, high: 180, unit: "± °", of: 1, hint: "of the camera's roll" },
  "attack.expectation.distance": { low: 0, high: 90, unit: "± %", of: 0.01, hint: "of the camera's distance" },
  "attack.expectation.intensity": { low: 0, high: 90, unit: "± %", of: 0.01, hint: "of the light's intensity" },
};

const words = (name) => name.replaceAll("_", " ");
// A description: what stands between backticks is code.
const prose = (text) => text.split("`").map((part, k) => (k % 2 ? element("code", {}, part) : part));
const rounded = (value) => Number(value.toFixed(6));
const general = (path) => path.map((key) => (typeof key === "number" ? "*" : key)).join(".");

export class Fields {
  // `changed` is called after a field has changed the request; `known` is the answer of /new/choices.json.
  // The camera's angles and distance are in `orbit`, all others in `root`.
  constructor(root, orbit, known, changed) {
    this.root = root;
    this.orbit = orbit;
    this.known = known;
    this.defs = known.schema.$defs;
    this.changed = changed;
    this.filled = {};
    this.displays = []; // of each field, what shows its value
  }

  // Shows a request. What is open and focused stays so.
  show(spec) {
    this.spec = spec;
    this.displays = [];
    const open = new Map([...this.root.querySelectorAll("details[id]")].map((one) => [one.id, one.open]));
    const focused = document.activeElement.id;
    const camera = this.defs.Camera.properties;
    this.root.replaceChildren(...this.object(this.known.schema, []));
    this.orbit.replaceChildren(...ORBIT.map((name) => this.field(name, camera[name], ["scene", "camera", name])));
    for (const [id, was] of open) document.getElementById(id)?.toggleAttribute("open", was);
    if (focused) document.getElementById(focused)?.focus();
  }

  // Shows the values of a filled-in request where the request has none.
  fill(filled) {
    this.filled = filled;
    this.display();
  }

  // Shows the request's values in all fields but the one that is being edited.
  display() {
    for (const display of this.displays) display();
  }

  // The value of a field: the request's own, or its default.
  value(path, schema) {
    for (const request of [this.spec, this.filled]) {
      if (at(request, path) !== undefined) return at(request, path);
    }
    return schema?.default;
  }

  set(path, value, rebuild = false) {
    put(this.spec, path, value);
    if (rebuild) this.show(this.spec);
    else this.display();
    this.changed();
  }

  get renderer() {
    return this.known.renderers[this.value(["attack", "renderer"]) ?? "torch"];
  }

  get method() {
    return at(this.spec, ["attack", "method"]) ?? this.renderer?.method;
  }

  // The names of the attacked groups. An empty list is an empty choice, which the page does not send.
  get chosen() {
    const given = at(this.spec, ["attack", "groups"]);
    if (Array.isArray(given)) return given;
    return (this.renderer?.groups ?? []).filter((group) => group.by_default).map((group) => group.name);
  }

  // Leaves out groups that the method cannot attack; if none is left, the first one that it can.
  fit() {
    const fitting = this.renderer?.fits[this.method] ?? [];
    const groups = this.chosen.filter((group) => fitting.includes(group));
    if (groups.length < this.chosen.length) this.spec.attack.groups = groups.length ? groups : fitting.slice(0, 1);
  }

  keep(names) {
    const attack = Object.entries(this.spec.attack ?? {});
    delete this.filled.attack; // its defaults were those of the attack before
    this.spec.attack = Object.fromEntries(attack.filter(([name]) => names.includes(name)));
  }

  // The fields of an object: the first ones, and the others folded.
  object(schema, path) {
    const place = general(path);
    const names = Object.keys(schema.properties).filter((name) => this.isOffered(place, name));
    const first = (FIRST[place] ?? names).filter((name) => names.includes(name));
    const rest = names.filter((name) => !first.includes(name));
    const made = first.map((name) => this.field(name, schema.properties[name], [...path, name]));
    if (!rest.length) return made;
    const folded = rest.map((name) => this.field(name, schema.properties[name], [...path, name]));
    const of = path.length ? `More of ${words(String(path.at(-1)))}` : "More";
    const id = `more-${path.join(".")}`;
    return [...made, element("details", { id }, element("summary", {}, TITLES[place] ?? of), ...folded)];
  }

  // Whether a field of an object has a place in the form: what cannot run is not offered, unless the request has it.
  isOffered(place, name) {
    if (place === "scene.camera") return !ORBIT.includes(name);
    if (place === "target" && name === "ask") return Boolean(this.target?.question || this.spec.target?.ask);
    if (place !== "attack.expectation" || !VARIED.includes(name)) return true;
    return this.renderer?.varies.includes(name) || Boolean(at(this.spec, ["attack", "expectation", name]));
  }

  get target() {
    const name = this.value(["target", "name"], this.defs.TargetChoice.properties.name);
    return this.known.targets.find((target) => target.name === name);
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
    if (place === "scene.objects.*.mesh" || place === "scene.fixed.*.mesh") return this.mesh(path);
    if (SLIDERS[place]) return this.slider(name, schema, path);
    return this.single(name, schema, path, kind);
  }

  group(name, schema, path, optional) {
    const id = `f-${path.join(".")}`;
    const given = at(this.spec, path);
    const title = LEGENDS[name] ?? words(name);
    const inside = [];
    if (optional) {
      const has = given !== undefined && given !== null;
      const box = element("input", { type: "checkbox", id: `${id}-has`, checked: has });
      box.addEventListener("change", () => this.set(path, box.checked ? this.start(name) : undefined, true));
      inside.push(element("p", { class: "check" }, box, element("label", { for: box.id }, `with ${words(name)}`), this.hint(schema, id)));
      if (has) inside.push(...this.object(schema, path));
    } else inside.push(...this.object(schema, path));
    const error = this.error(id);
    if (OPEN.includes(general(path))) {
      return element("fieldset", { id }, element("legend", {}, title), error, ...inside);
    }
    return element("details", { id, open: inside.length > 1 && optional }, element("summary", {}, title), error, ...inside);
  }

  // The first value of an optional object: an expectation over nothing would be refused.
  start(name) {
    if (name !== "expectation") return {};
    return this.renderer?.varies.includes("azimuth") ? { azimuth: 30 } : { sensor: {} };
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
      const like = { objects: given, fixed: at(this.spec, ["scene", "objects"]) ?? [] }[path.at(-1)];
      this.set(path, [...given, { ...like?.at(-1) }], true);
      document.getElementById(`f-${[...path, given.length].join(".")}`).querySelector("summary, input, select").focus();
    });
    const full = given.length >= (schema.maxItems ?? Infinity);
    return element("div", { id, class: "list" }, this.error(id), ...made, ...(full ? [] : [add]));
  }

  attack(path) {
    const union = this.known.schema.properties.attack;
    const method = this.method;
    const reference = union.discriminator.mapping[method] ?? Object.values(union.discriminator.mapping)[0];
    const schema = resolved({ $ref: reference }, this.defs);
    const methods = { type: "string", enum: Object.keys(union.discriminator.mapping), description: schema.description };
    return this.group("attack", { ...schema, properties: { ...schema.properties, method: methods } }, path, false);
  }

  // The groups that the method can attack: first those with a natural range, then those whose values are free.
  groups(path) {
    const id = `f-${path.join(".")}`;
    const all = this.renderer?.groups ?? [];
    const chosen = this.chosen;
    const fitting = this.renderer?.fits[this.method] ?? [];
    const offered = all.filter((one) => fitting.includes(one.name) || chosen.includes(one.name));
    const choice = (one) => {
      const box = element("input", { type: "checkbox", id: `${id}-${one.name}`, value: one.name, checked: chosen.includes(one.name), "aria-describedby": `${id}-${one.name}-hint` });
      box.addEventListener("change", () => {
        // Settings by group are refused for one that is not attacked.
        for (const settings of Object.values(this.spec.attack ?? {})) delete settings?.[one.name];
        this.set(path, [...field.querySelectorAll("input:checked")].map((other) => other.value));
      });
      const range = one.natural_range ? [element("strong", {}, one.natural_range)] : [];
      const said = one.explanation ? [one.explanation, ...(range.length ? [": "] : [])] : [];
      const hint = element("small", { class: "hint", id: `${id}-${one.name}-hint` }, ...said, ...range);
      return element("div", { class: "choice" }, box, element("label", { for: box.id }, one.words, " ", element("code", {}, one.name)), hint, ...(one.natural_range && one.limit ? [this.share(one, box)] : []));
    };
    const part = (title, some) => (some.length ? [element("fieldset", {}, element("legend", {}, title), ...some.map(choice))] : []);
    const field = element(
      "fieldset",
      { id, class: "plain", "aria-describedby": `${id}-error` },
      element("legend", {}, "groups"),
      element("span", { class: "error", id: `${id}-error`, role: "alert" }),
      ...part("Changes a thing could have", offered.filter((one) => one.natural_range)),
      ...part("Free values, without a natural range", offered.filter((one) => !one.natural_range)),
    );
    return field;
  }

  // A slider for the largest change of an attacked group: a share of its natural range, of which the whole is the default.
  share(group, box) {
    const path = ["attack", "epsilon", group.name];
    const id = `${box.id}-share`;
    const slider = element("input", { type: "range", id, min: 5, max: 100, step: 5, "aria-describedby": `${box.id}-hint` });
    const output = element("output", { for: id });
    const line = element("div", { class: "slider" }, slider, output);
    const field = element("div", { class: "share" }, element("label", { for: id }, `${group.words}: share of its natural range`), line);
    slider.addEventListener("input", () => {
      const percent = slider.valueAsNumber;
      this.set(path, percent < 100 ? rounded((percent / 100) * group.limit) : undefined);
    });
    const display = () => {
      const epsilon = at(this.spec, path);
      const percent = typeof epsilon === "number" ? (100 * epsilon) / group.limit : 100;
      slider.value = percent;
      output.value = `${Number(percent.toFixed(1))} %`;
      field.hidden = !box.checked;
    };
    this.displays.push(display);
    display();
    return field;
  }

  mesh(path) {
    const id = `f-${path.join(".")}`;
    const picker = meshPicker(id, this.known.meshes, at(this.spec, path), (name) => this.set(path, name));
    return element("div", { class: "field" }, element("span", { class: "label" }, "mesh"), picker, this.error(id));
  }

  // A number beside a slider, both in the unit of `SLIDERS`.
  slider(name, schema, path) {
    const id = `f-${path.join(".")}`;
    const { low, high, step = 1, unit, of, hint } = SLIDERS[general(path)];
    const number = element("input", { id, inputmode: "decimal", autocomplete: "off", "aria-describedby": `${id}-hint` });
    const slider = element("input", { type: "range", id: `${id}-slider`, min: low, max: high, step, "aria-label": `${words(name)}, slider`, "aria-describedby": `${id}-hint` });
    number.addEventListener("input", () => {
      const value = read(number.value, "number");
      this.set(path, typeof value === "number" ? rounded(value * of) : value);
    });
    slider.addEventListener("input", () => this.set(path, rounded(slider.valueAsNumber * of)));
    this.shows(number, () => {
      const value = this.value(path, schema);
      slider.value = typeof value === "number" ? value / of : low;
      return written(typeof value === "number" ? Number((value / of).toFixed(2)) : value, "number");
    });
    const line = element("div", { class: "slider" }, slider, number, element("span", { "aria-hidden": "true" }, unit));
    return element("div", { class: "field" }, element("label", { for: id }, words(name)), line, this.hint(hint ? { description: hint } : schema, id), this.error(id));
  }

  // Keeps the text of an input up to date, but while it is edited.
  shows(input, text) {
    const display = () => {
      const shown = text();
      if (document.activeElement !== input) input.value = shown;
    };
    input.addEventListener("blur", display);
    this.displays.push(display);
    display();
  }

  tuple(name, schema, path) {
    const id = `f-${path.join(".")}`;
    const inputs = schema.prefixItems.map((_, k) => {
      const input = element("input", { inputmode: "decimal", id: `${id}.${k}`, autocomplete: "off" });
      input.addEventListener("input", () => {
        const texts = inputs.map((one) => one.value);
        const rest = at(this.filled, path) ?? schema.default ?? [];
        const all = texts.map((text, at) => read(text, "number") ?? rest[at] ?? 0);
        this.set(path, texts.every((text) => !text.trim()) ? undefined : all);
      });
      this.shows(input, () => written(this.value([...path, k], { default: schema.default?.[k] }), "number"));
      return input;
    });
    const axes = AXES[name] ?? ["x", "y", "z"];
    const labelled = inputs.map((input, k) => element("label", {}, axes[k] ?? k + 1, input));
    return element("fieldset", { id, class: "inline" }, element("legend", {}, words(name)), ...labelled, this.hint(schema, id), this.error(id));
  }

  picture(name, schema, path) {
    const id = `f-${path.join(".")}`;
    const camera = (of) => at(of, ["scene", "camera", "size"]);
    const size = () => camera(this.spec) ?? camera(this.filled) ?? this.defs.Camera.properties.size.default;
    const made = pictureField(id, words(name), at(this.spec, path), size, (picture) => this.set(path, picture, true));
    return element("div", { class: "field" }, ...made, this.hint(schema, id), this.error(id));
  }

  // The names that a text may have, as [name, words]; undefined where any text may be.
  names(place, schema) {
    const { known } = this;
    if (place === "scene.objects.*.material" || place === "scene.floor.material") return known.materials;
    if (place === "scene.lights.environment.map") return known.environments;
    if (place === "target.name") {
      const hasGradient = (target) => target.gradient || !known.gradient_methods.includes(this.method);
      const fits = (target) => hasGradient(target) && (!target.question || at(this.spec, ["scene", "source"])); // questions are about scenes that are known
      return known.targets.filter(fits).map((target) => [target.name, target.words]);
    }
    if (place === "attack.renderer") return Object.entries(known.renderers).map(([name, one]) => [name, one.words]);
    if (place === "attack.method") {
      const summary = (name) => resolved({ $ref: known.schema.properties.attack.discriminator.mapping[name] }, this.defs).description.split(":")[0];
      const fitting = schema.enum.filter((name) => !this.renderer || this.renderer.fits[name].length);
      return fitting.map((name) => [name, summary(name)]);
    }
    return schema.enum?.map((name) => [name, ""]);
  }

  single(name, schema, path, kind) {
    const place = general(path);
    const id = `f-${path.join(".")}`;
    const names = this.names(place, schema);
    const common = { id, "aria-describedby": `${id}-hint` };
    const own = () => (place === "attack.method" ? this.method : this.value(path, schema));
    if (names) return this.choice(name, schema, path, names, own);
    let input;
    if (kind === "check") {
      input = element("input", { ...common, type: "checkbox" });
      const display = () => (input.checked = own() ?? false);
      this.displays.push(display);
      display();
    } else {
      const tag = schema.type === "object" ? "textarea" : "input"; // values by group may be long
      input = element(tag, { ...common, inputmode: kind === "number" && "decimal", autocomplete: "off", spellcheck: "false", placeholder: "none" });
      this.shows(input, () => written(own(), kind));
    }
    input.addEventListener(kind === "check" ? "change" : "input", () => this.set(path, kind === "check" ? input.checked : read(input.value, kind)));
    const label = element("label", { for: id }, words(name));
    const parts = kind === "check" ? [input, label] : [label, input];
    return element("div", { class: kind === "check" ? "field check" : "field" }, ...parts, this.hint(schema, id), this.error(id));
  }

  // A menu of names, each with its words. A name of the request that is not among them stays.
  choice(name, schema, path, names, own) {
    const place = general(path);
    const id = `f-${path.join(".")}`;
    const option = ([value, said]) => element("option", { value }, said && value ? `${value}: ${said}` : said || value);
    const select = element("select", { id, "aria-describedby": `${id}-hint` }, ...names.map(option));
    if (schema.default === null) select.prepend(option(["", "none"]));
    const display = () => {
      const value = written(own(), "choice");
      if (![...select.options].some((one) => one.value === value)) select.prepend(option([value, value ? "" : "none"]));
      select.value = value;
    };
    select.addEventListener("change", () => {
      put(this.spec, path, select.value || undefined);
      if (place === "attack.renderer" || place === "attack.method") this.keep(KEPT[path.at(-1)]);
      if (place === "attack.method") this.fit();
      if (place === "target.name") this.ask();
      if (["attack.renderer", "attack.method", "target.name"].includes(place)) this.show(this.spec);
      this.changed();
    });
    this.displays.push(display);
    display();
    return element("div", { class: "field" }, element("label", { for: id }, words(name)), select, this.hint(schema, id), this.error(id));
  }

  // Asks a network that answers questions one that it takes, and another network none.
  ask() {
    const question = this.target?.question;
    put(this.spec, ["target", "ask"], question ? { question } : undefined);
    delete this.filled.target;
  }

  hint(schema, id) {
    return element("small", { class: "hint", id: `${id}-hint` }, ...prose(schema.description ?? ""));
  }

  error(id) {
    return element("span", { class: "error", id: `${id}-error` });
  }
}
