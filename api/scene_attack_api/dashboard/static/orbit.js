// A viewpoint on a sphere about the origin, turned by drag, wheel and keys: {azimuth, elevation, distance, roll} as a
// camera of the service has them, in radians and scene units.

const HIGHEST = Math.PI / 2;
const STEP = Math.PI / 36;
const CLOSER = 1 / 1.1;
const NEAREST = 0.1; // of the first distance
const FURTHEST = 4;

export class Orbit {
  // Begins at `home`; `changed` is called after each turn.
  constructor(element, home, changed) {
    this.home = home;
    this.view = { ...home };
    this.changed = changed;
    let from = null;
    element.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      from = [event.clientX, event.clientY];
      element.setPointerCapture(event.pointerId);
    });
    element.addEventListener("pointermove", (event) => {
      if (!from) return;
      const scale = Math.PI / element.clientHeight;
      this.turn((from[0] - event.clientX) * scale, (event.clientY - from[1]) * scale);
      from = [event.clientX, event.clientY];
    });
    for (const kind of ["pointerup", "pointercancel"]) element.addEventListener(kind, () => (from = null));
    // A page is scrolled past the view; the wheel zooms once the view has the focus.
    element.addEventListener("wheel", (event) => {
      if (document.activeElement !== element) return;
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY / 500));
    }, { passive: false });
    element.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const turns = { ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
    if (turns[event.key]) this.turn(...turns[event.key]);
    else if (event.key === "+" || event.key === "=") this.nearer();
    else if (event.key === "-") this.further();
    else if (event.key === "0" || event.key === "Home") this.reset();
    else return;
    event.preventDefault();
  }

  turn(azimuth, elevation) {
    this.view.azimuth += azimuth;
    this.view.elevation = Math.max(-HIGHEST, Math.min(HIGHEST, this.view.elevation + elevation));
    this.changed();
  }

  zoom(factor) {
    const { distance } = this.home;
    this.view.distance = Math.max(NEAREST * distance, Math.min(FURTHEST * distance, this.view.distance * factor));
    this.changed();
  }

  nearer() {
    this.zoom(CLOSER);
  }

  further() {
    this.zoom(1 / CLOSER);
  }

  reset() {
    this.view = { ...this.home };
    this.changed();
  }

  // Another home. A view that is there already goes along.
  rehome(home) {
    const isHome = Object.keys(home).every((name) => this.view[name] === this.home[name]);
    this.home = home;
    if (isHome) this.view = { ...home };
  }
}

// World from camera, 16 numbers column by column, of a camera that looks at the origin.
export function pose({ azimuth, elevation, distance, roll }) {
  const { right, up, back } = axes(azimuth, elevation);
  const mixed = (a, u, b, v) => u.map((_, k) => a * u[k] + b * v[k]);
  const x = mixed(Math.cos(roll), right, Math.sin(roll), up);
  const y = mixed(Math.cos(roll), up, -Math.sin(roll), right);
  return [...x, 0, ...y, 0, ...back, 0, ...back.map((one) => distance * one), 1];
}

// The viewpoint of such a camera.
export function viewpoint(matrix) {
  const back = matrix.slice(8, 11);
  const azimuth = Math.atan2(back[0], back[2]);
  const elevation = Math.asin(Math.max(-1, Math.min(1, back[1])));
  const { right, up } = axes(azimuth, elevation);
  const along = (axis) => axis.reduce((sum, one, k) => sum + one * matrix[k], 0);
  return { azimuth, elevation, distance: Math.hypot(...matrix.slice(12, 15)), roll: Math.atan2(along(up), along(right)) };
}

// The axes of an upright camera, in the world.
function axes(azimuth, elevation) {
  const [sa, ca, se, ce] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(elevation), Math.cos(elevation)];
  return { right: [ca, 0, -sa], up: [-se * sa, ce, -se * ca], back: [sa * ce, se, ca * ce] };
}
