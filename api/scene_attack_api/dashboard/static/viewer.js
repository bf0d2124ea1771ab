// <before-after before="URL" after="URL">: one large viewer of two images of the same size, above the figures that it
// contains. Without this script, or if an image cannot be read, the figures stand side by side.
import { drawDivider, paint } from "./viewer_drawing.js";
import { differences, fitted, zoomedAt } from "./viewer_geometry.js";

const LARGEST = 64; // screen pixels for one pixel of the image

async function pixelsOf(address) {
  const image = new Image();
  image.src = address;
  await image.decode();
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  return { canvas, data: context.getImageData(0, 0, canvas.width, canvas.height).data };
}

function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

class BeforeAfter extends HTMLElement {
  static observedAttributes = ["before", "after"];

  connectedCallback() {
    this.state ??= { mode: "slide", divider: 0.5, gain: 5, scale: null, left: 0, top: 0, at: null };
    this.load();
  }

  disconnectedCallback() {
    this.resizes?.disconnect();
  }

  attributeChangedCallback(name, old) {
    if (old !== null && this.isConnected) this.load();
  }

  async load() {
    const wanted = [this.getAttribute("before"), this.getAttribute("after")];
    try {
      const [before, after] = await Promise.all(wanted.map(pixelsOf));
      if (wanted[0] !== this.getAttribute("before") || wanted[1] !== this.getAttribute("after")) return;
      if (before.data.length !== after.data.length) return;
      [this.before, this.after, this.shown] = [before, after, null];
      if (!this.canvas) this.build();
      this.draw();
    } catch {
      // The figures stay as they are.
    }
  }

  build() {
    const place = this.querySelector("[data-own]");
    this.canvas = element("canvas", { tabIndex: 0 });
    this.canvas.setAttribute("role", "img");
    this.readout = element("output", { className: "readout", textContent: "\u00a0" });
    this.slider = this.range("Divider, in % from the left", 0, 100, 1, 50, (value) => (this.state.divider = value / 100));
    this.gain = this.range("Difference ×", 1, 20, 1, this.state.gain, (value) => {
      this.state.gain = value;
      this.choose("difference");
    });
    const modes = element("fieldset", { className: "modes" }, element("legend", { className: "sr", textContent: "Show" }));
    const named = { slide: "Slide", before: "Original", after: "Attacked", difference: "Difference", both: "Side by side" };
    this.modes = {};
    for (const [mode, word] of Object.entries(named)) {
      const input = element("input", { type: "radio", name: "viewer-mode", value: mode, checked: mode === this.state.mode });
      input.addEventListener("change", () => this.choose(mode));
      modes.append(element("label", {}, input, element("span", { textContent: word })));
      this.modes[mode] = input;
    }
    const button = (word, label, action) => {
      const made = element("button", { type: "button", className: "plain", textContent: word, title: label });
      made.setAttribute("aria-label", label);
      made.addEventListener("click", action);
      return made;
    };
    const zoom = element("span", { className: "zoom" },
      button("−", "Zoom out", () => this.zoom(0.5)),
      button("+", "Zoom in", () => this.zoom(2)),
      button("Fit", "Fit the whole image", () => this.fit()),
      button("Flip", "Flip between original and attacked (F)", () => this.flip()));
    place.replaceChildren(
      element("div", { className: "bar" }, modes, zoom),
      this.canvas,
      element("div", { className: "bar" }, this.slider.label, this.gain.label, this.readout),
      element("p", { className: "note", textContent: "Keys on the image: F flips, D shows the difference, S the slider, + and − zoom, 0 fits, arrows move. Zoomed in far enough, each pixel shows its red, green and blue in 0…255." }));
    place.hidden = false;
    this.listen();
  }

  range(word, min, max, step, value, changed) {
    const input = element("input", { type: "range", min, max, step, value });
    const shown = element("output", { textContent: value });
    input.addEventListener("input", () => {
      changed(Number(input.value));
      shown.textContent = input.value;
      this.draw();
    });
    return { input, shown, label: element("label", {}, `${word} `, input, " ", shown) };
  }

  listen() {
    const { canvas } = this;
    this.resizes = new ResizeObserver(() => this.draw());
    this.resizes.observe(canvas);
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? 1.25 : 0.8, this.pointer(event));
    }, { passive: false });
    canvas.addEventListener("dblclick", (event) => this.zoom(2, this.pointer(event)));
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      const [x, y] = this.pointer(event);
      const onDivider = this.state.mode === "slide" && Math.abs(x - this.state.divider * canvas.clientWidth) < 24;
      this.drag = { x, y, divides: onDivider || (this.state.mode === "slide" && this.state.scale === null) };
      this.move(event);
    });
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (this.drag = null));
  }

  pointer(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  move(event) {
    const [x, y] = this.pointer(event);
    if (this.drag?.divides) {
      this.divide(x / this.canvas.clientWidth);
    } else if (this.drag && this.state.scale !== null) {
      this.pan((this.drag.x - x) / this.state.scale, (this.drag.y - y) / this.state.scale);
      [this.drag.x, this.drag.y] = [x, y];
    }
    this.state.at = [x, y];
    this.draw();
  }

  divide(share) {
    this.state.divider = Math.min(1, Math.max(0, share));
    this.slider.input.value = Math.round(100 * this.state.divider);
    this.slider.shown.textContent = this.slider.input.value;
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = this.state.scale === null ? 0 : 40 / this.state.scale;
    const arrows = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    const actions = {
      f: () => this.flip(), d: () => this.choose("difference"), s: () => this.choose("slide"),
      "+": () => this.zoom(2), "=": () => this.zoom(2), "-": () => this.zoom(0.5), 0: () => this.fit(),
    };
    if (event.key in arrows && this.state.scale !== null) this.pan(...arrows[event.key]);
    else if (event.key.startsWith("Arrow") && this.state.mode === "slide" && !arrows[event.key][1])
      this.divide(this.state.divider + { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key] || this.state.divider);
    else if (event.key.toLowerCase() in actions) actions[event.key.toLowerCase()]();
    else return;
    event.preventDefault();
    this.draw();
  }

  choose(mode) {
    this.state.mode = mode;
    this.modes[mode].checked = true;
    this.draw();
  }

  flip() {
    this.choose(this.state.mode === "after" ? "before" : "after");
  }

  fit() {
    Object.assign(this.state, { scale: null, left: 0, top: 0 });
    this.draw();
  }

  pane() {
    const width = this.canvas.clientWidth / (this.state.mode === "both" ? 2 : 1);
    return fitted(this.before.canvas, width, this.canvas.clientHeight, this.state);
  }

  zoom(factor, at) {
    const pane = this.pane();
    const [x, y] = at ?? [pane.width / 2, pane.height / 2];
    Object.assign(this.state, zoomedAt(pane, x % pane.width, y, factor, LARGEST));
    this.draw();
  }

  pan(x, y) {
    this.state.left += x;
    this.state.top += y;
  }

  differing() {
    if (this.shown?.gain !== this.state.gain) {
      const { width, height } = this.before.canvas;
      const canvas = element("canvas", { width, height });
      const data = differences(this.before.data, this.after.data, this.state.gain);
      canvas.getContext("2d").putImageData(new ImageData(data, width, height), 0, 0);
      this.shown = { gain: this.state.gain, canvas, data };
    }
    return this.shown;
  }

  draw() {
    const { canvas, state } = this;
    if (!canvas?.clientWidth) return;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const pane = this.pane();
    Object.assign(state, pane.kept);
    const edge = state.divider * width;
    if (state.mode === "slide") {
      paint(context, this.before, pane, 0, 0, edge);
      paint(context, this.after, pane, 0, edge, width);
      drawDivider(context, edge, height);
    } else if (state.mode === "both") {
      paint(context, this.before, pane, 0, 0, width / 2 - 1);
      paint(context, this.after, pane, width / 2, width / 2 + 1, width);
    } else {
      const image = state.mode === "difference" ? this.differing() : this[state.mode];
      paint(context, image, pane, 0, 0, width);
    }
    this.say(pane);
  }

  say(pane) {
    const { state, canvas } = this;
    const { width, height } = this.before.canvas;
    const shown = { slide: `original left of ${Math.round(100 * state.divider)} %, attacked right of it`, before: "original",
      after: "attacked", difference: `difference times ${state.gain}, around middle grey`, both: "original and attacked" };
    canvas.setAttribute("aria-label", `The scene, ${shown[state.mode]}, ${width} by ${height} pixels, zoom ${pane.scale.toFixed(1)}`);
    canvas.dataset.scale = pane.scale;
    if (!state.at) return;
    const column = Math.floor(((state.at[0] % pane.width) - pane.x) / pane.scale);
    const row = Math.floor((state.at[1] - pane.y) / pane.scale);
    if (column < 0 || row < 0 || column >= width || row >= height) return;
    const [one, other] = [this.before, this.after].map((image) => [...image.data.subarray(4 * (row * width + column), 4 * (row * width + column) + 3)]);
    const signed = other.map((value, k) => value - one[k]).map((value) => (value > 0 ? `+${value}` : value).toString().replace("-", "−"));
    this.readout.textContent = `x ${column}, y ${row}: ${one.join(" ")} → ${other.join(" ")} (${signed.join(" ")})`;
  }
}

customElements.define("before-after", BeforeAfter);
