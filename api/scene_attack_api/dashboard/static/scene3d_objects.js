// What the view in three dimensions draws of a scene that `readGlb` has read.

export const COLORS = { before: 0x2f7dd1, after: 0xd9480f };

// Light from all around that is brighter above, as scenes have it: radiance 1 + w.y / 2 from direction w.
export function skyLight(three) {
  const rows = 64;
  const texels = new Uint16Array(4 * rows);
  for (let row = 0; row < rows; row++) {
    const radiance = 1 + Math.sin(Math.PI * ((row + 0.5) / rows - 0.5)) / 2; // from straight below to straight above
    texels.fill(three.DataUtils.toHalfFloat(radiance), 4 * row, 4 * row + 4);
  }
  const sky = new three.DataTexture(texels, 1, rows, three.RGBAFormat, three.HalfFloatType, three.EquirectangularReflectionMapping);
  Object.assign(sky, { magFilter: three.LinearFilter, minFilter: three.LinearFilter, needsUpdate: true });
  return sky;
}

// The objects with the lamps of the scene.
export function lit({ root, lights, extras }, three) {
  const group = new three.Group().add(root);
  for (const light of lights) group.add(...lamp(light, three));
  if (extras.ambient === undefined) {
    // The image's light is a map, which the file does not have.
    const sun = new three.DirectionalLight(0xffffff, 1.5);
    sun.position.set(1, 2, 1.5);
    group.add(sun);
  }
  return group;
}

function lamp(light, three) {
  const kinds = { point: three.PointLight, directional: three.DirectionalLight, spot: three.SpotLight };
  const made = new kinds[light.type](0xffffff, light.intensity);
  made.position.setFromMatrixPosition(light.matrix);
  if (light.type === "point") return [made];
  made.target.position.copy(direction(light, three)).add(made.position);
  if (light.type === "spot") {
    made.angle = light.spot.outerConeAngle;
    made.penumbra = 1 - light.spot.innerConeAngle / light.spot.outerConeAngle;
  }
  return [made, made.target];
}

// The direction in which a light shines, in the world.
function direction(light, three) {
  return new three.Vector3(0, 0, -1).transformDirection(light.matrix);
}

// Where the lights are and shine to, and the frame of the image before the camera.
export function marks({ lights, camera }, color, three) {
  const group = new three.Group();
  for (const light of lights) {
    const ball = new three.Mesh(new three.SphereGeometry(0.05, 16, 12), new three.MeshBasicMaterial({ color }));
    ball.position.setFromMatrixPosition(light.matrix);
    group.add(ball);
    if (light.type === "point") continue;
    const along = direction(light, three);
    if (light.type === "directional") ball.position.copy(along).multiplyScalar(-1.5); // it has no place
    group.add(new three.ArrowHelper(along, ball.position, 0.4, color, 0.1, 0.06));
  }
  const depth = 0.25;
  const high = depth * Math.tan(camera.lens.yfov / 2);
  const wide = high * camera.lens.aspectRatio;
  const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => new three.Vector3(x * wide, y * high, -depth));
  const eye = new three.Vector3();
  const lines = corners.flatMap((corner, k) => [eye, corner, corner, corners[(k + 1) % 4]]);
  const shape = new three.BufferGeometry().setFromPoints(lines);
  const frame = new three.LineSegments(shape, new three.LineBasicMaterial({ color }));
  frame.applyMatrix4(camera.matrix);
  return group.add(frame);
}

// The objects as a transparent shade of themselves.
export function ghost(root, three) {
  const copy = root.clone(true);
  const shade = new three.MeshBasicMaterial({ color: COLORS.before, transparent: true, opacity: 0.3, depthWrite: false });
  copy.traverse((node) => {
    if (node.isMesh) node.material = shade;
  });
  return copy;
}
