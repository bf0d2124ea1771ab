// A field for a mesh: the chosen one's picture and name, which open all others by kind, found by words.
import { element } from "./element.js";

const picture = (mesh) => (mesh?.picture ? element("img", { src: mesh.picture, alt: "", width: 64, height: 64, loading: "lazy" }) : element("span", { class: "blank" }));

// `meshes` are { name, title, kind, picture }, those of a kind one after the other; `chosen` is called with a name. The
// arrow keys walk through the meshes; Enter and the mouse's choice close the field.
export function meshPicker(id, meshes, value, chosen) {
  const summary = element("summary", { id });
  const all = element("div", { class: "meshes" });
  const search = element("input", { type: "search", id: `${id}-search`, autocomplete: "off" });
  const count = element("small", { role: "status", class: "hint" });
  const picker = element(
    "details",
    { class: "picker" },
    summary,
    element("label", { for: search.id }, "Words of a name"),
    search,
    count,
    all,
  );

  function name(current) {
    const mesh = meshes.find((one) => one.name === current);
    summary.replaceChildren(picture(mesh), element("span", {}, mesh?.title ?? "no such mesh", " ", element("code", {}, current ?? "")), element("small", {}, "choose another"));
  }

  function list() {
    const words = search.value.toLowerCase().split(/\s+/);
    const matching = meshes.filter((mesh) => words.every((word) => `${mesh.name} ${mesh.title} ${mesh.kind}`.toLowerCase().includes(word)));
    const kinds = Map.groupBy(matching, (mesh) => mesh.kind);
    count.textContent = `${matching.length} of ${meshes.length} meshes`;
    all.replaceChildren(...[...kinds].map(([kind, some]) => element("fieldset", {}, element("legend", {}, kind), ...some.map(choice))));
  }

  function choice(mesh) {
    const radio = element("input", { type: "radio", name: id, value: mesh.name, checked: mesh.name === value });
    return element("label", { title: mesh.name }, radio, picture(mesh), element("span", {}, mesh.title));
  }

  function close() {
    picker.open = false;
    summary.focus();
  }

  name(value);
  search.addEventListener("input", list);
  picker.addEventListener("toggle", () => {
    if (!picker.open) return;
    list();
    const current = all.querySelector(":checked");
    if (current) all.scrollTop = current.closest("label").offsetTop;
  });
  all.addEventListener("change", (event) => {
    value = event.target.value;
    name(value);
    chosen(value);
  });
  picker.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" || event.target === summary) return; // which would submit the job
    event.preventDefault();
    if (event.target !== search) close();
  });
  all.addEventListener("click", (event) => {
    if (event.detail && event.target.matches("input")) close(); // a click without a count is an arrow key's
  });
  return picker;
}
