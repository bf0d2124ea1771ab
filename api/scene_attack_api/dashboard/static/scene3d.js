// <scene-3d>: a scene in three dimensions, with its lights and its camera, before and after an attack or alone.
// Once its part of the page is opened it loads three.js and the scenes, and it draws only when something changed.
import { readGlb } from "./glb.js";
import { Orbit, pose, viewpoint } from "./orbit.js";
import { COLORS, ghost, lit, marks, skyLight } from "./scene3d_objects.js";

const HELP = "Drag, or press the arrow keys, to turn the scene; + and − come nearer and go away; 0 returns.";

class Scene3d extends HTMLElement {
  connectedCallback() {
    const part = this.closest("details");
    part.addEventListener("toggle", () => this.begin(part.open));
    this.begin(part.open);
  }

  begin(isOpen) {
    if (!isOpen || this.begun) return;
    this.begun = true;
    this.load().catch((error) => {
      this.begun = false; // opening the part again tries again
      this.say(`The scene cannot be shown: ${error.message}.`);
    });
  }

  say(text) {
    this.querySelector("[role=status]").textContent = text;
  }

  async load() {
    const canvas = this.querySelector("canvas");
    const context = canvas.getContext("webgl2", { alpha: false, antialias: true });
    if (!context) throw new Error("this browser has no WebGL");
    this.say("Loading the scene …");
    const sides = Object.keys(COLORS).filter((side) => this.dataset[side]);
    const [three, ...files] = await Promise.all([
      import("./vendor/three/three.module.js"),
      ...sides.map((side) => fetched(this.dataset[side])),
    ]);
    const scenes = await Promise.all(files.map((file) => readGlb(file, three)));
    for (const one of this.querySelectorAll("[hidden]")) one.hidden = false;
    this.show(canvas, context, three, Object.fromEntries(sides.map((side, k) => [side, scenes[k]])));
    this.say(HELP);
  }

  // `scenes`: before and after the attack, or one alone.
  show(canvas, context, three, scenes) {
    const renderer = new three.WebGLRenderer({ canvas, context });
    const world = new three.Scene();
    world.environment = skyLight(three);
    const camera = new three.PerspectiveCamera();
    const shown = {};
    const marked = {};
    for (const [side, scene] of Object.entries(scenes)) {
      world.add((shown[side] = lit(scene, three)), (marked[side] = marks(scene, COLORS[side], three)));
    }
    if (scenes.after) world.add((shown.ghost = ghost(scenes.before.root, three)));

    // The side whose scene is shown; "both" is the attacked one with a shade of the original.
    const chosen = () => this.querySelector("input[type=radio]:checked")?.value ?? "before";
    const seen = () => scenes[chosen() === "both" ? "after" : chosen()];
    let waiting = false;
    const redraw = () => {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => {
        waiting = false;
        const which = chosen();
        const isMarked = this.querySelector("input[type=checkbox]")?.checked ?? false;
        for (const side of Object.keys(scenes)) {
          shown[side].visible = scenes[side] === seen();
          marked[side].visible = isMarked && (which === side || which === "both");
        }
        if (shown.ghost) shown.ghost.visible = which === "both";
        world.background = new three.Color().setRGB(...seen().extras.ground, three.SRGBColorSpace);
        world.environmentIntensity = seen().extras.ambient ?? 0.7;
        new three.Matrix4().fromArray(pose(orbit.view)).decompose(camera.position, camera.quaternion, camera.scale);
        frame(camera, seen().camera.lens, canvas.clientWidth / canvas.clientHeight);
        renderer.render(world, camera);
        this.dataset.drawings = String(Number(this.dataset.drawings ?? 0) + 1);
      });
    };

    const home = () => viewpoint(seen().camera.matrix.elements);
    const orbit = new Orbit(canvas, home(), () => {
      const { azimuth, elevation, distance } = orbit.view;
      const degrees = (angle) => `${Math.round((180 / Math.PI) * Math.atan2(Math.sin(angle), Math.cos(angle)))}°`;
      this.say(`Azimuth ${degrees(azimuth)}, elevation ${degrees(elevation)}, distance ${distance.toFixed(2)}.`);
      redraw();
    });
    this.addEventListener("change", () => {
      orbit.rehome(home());
      redraw();
    });
    this.addEventListener("click", (event) => orbit[event.target.dataset.orbit]?.());
    new ResizeObserver(() => {
      const { clientWidth, clientHeight } = canvas;
      if (!clientWidth || !clientHeight) return; // the part is closed
      renderer.setPixelRatio(Math.min(2, devicePixelRatio));
      renderer.setSize(clientWidth, clientHeight, false);
      redraw();
    }).observe(canvas);
  }
}

// A lens for a view of this aspect in which all of the image is seen, as large as it can be.
function frame(camera, lens, aspect) {
  const share = Math.min(1, aspect / lens.aspectRatio);
  camera.aspect = aspect;
  camera.fov = (360 / Math.PI) * Math.atan(Math.tan(lens.yfov / 2) / share);
  camera.near = lens.znear;
  camera.far = 5 * lens.zfar; // the view may go four times as far away as the image's camera is
  camera.updateProjectionMatrix();
}

async function fetched(address) {
  const response = await fetch(address);
  if (response.ok) return response.arrayBuffer();
  const problem = await response.json().catch(() => ({}));
  throw new Error(problem.detail ?? `the service answered ${response.status}`);
}

customElements.define("scene-3d", Scene3d);
