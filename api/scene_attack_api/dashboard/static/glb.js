// Makes three.js objects of a .glb file as the service writes it. It asks for nothing: images are decoded from the
// file's bytes, so that the page's content-security policy needs no exception for addresses of data.

const FLOAT = 5126;
const WIDTHS = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };
const ATTRIBUTES = {
  POSITION: "position", NORMAL: "normal", TANGENT: "tangent", TEXCOORD_0: "uv", TEXCOORD_1: "uv1", COLOR_0: "color",
};
const LIGHTS = "KHR_lights_punctual";

// { root: Group, camera: { lens, matrix }, lights: [{ type, intensity, spot, matrix }], extras }
export async function readGlb(buffer, three) {
  const view = new DataView(buffer);
  // A header of 12 bytes, then two chunks, each with 8 bytes before it: JSON, and the bytes that it refers to.
  const length = view.getUint32(12, true);
  const json = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, length)));
  const start = 28 + length;
  const bytes = (index) => {
    const { byteOffset, byteLength } = json.bufferViews[index];
    return new Uint8Array(buffer, start + byteOffset, byteLength);
  };
  const bitmaps = await Promise.all((json.images ?? []).map((image) => bitmap(bytes(image.bufferView), image.mimeType)));
  const made = new Map();
  const texture = (used, color) => {
    if (!used) return null;
    const key = `${used.index} ${used.texCoord} ${color}`;
    if (!made.has(key)) {
      const { source, sampler } = json.textures[used.index];
      const created = new three.Texture(bitmaps[source]);
      const wraps = { 10497: three.RepeatWrapping, 33071: three.ClampToEdgeWrapping, 33648: three.MirroredRepeatWrapping };
      const { wrapS, wrapT } = json.samplers[sampler];
      Object.assign(created, { flipY: false, channel: used.texCoord, wrapS: wraps[wrapS], wrapT: wraps[wrapT] });
      if (color) created.colorSpace = three.SRGBColorSpace;
      created.needsUpdate = true;
      made.set(key, created);
    }
    return made.get(key);
  };
  const attribute = (index) => {
    const { bufferView, componentType, count, type } = json.accessors[index];
    const data = bytes(bufferView);
    const kind = componentType === FLOAT ? Float32Array : Uint32Array;
    // A copy begins at a multiple of four bytes, as the array needs.
    return new three.BufferAttribute(new kind(data.slice().buffer, 0, count * WIDTHS[type]), WIDTHS[type]);
  };
  const mesh = ({ primitives: [part] }) => {
    const geometry = new three.BufferGeometry();
    for (const [name, index] of Object.entries(part.attributes)) geometry.setAttribute(ATTRIBUTES[name], attribute(index));
    geometry.setIndex(attribute(part.indices));
    return new three.Mesh(geometry, material(json.materials[part.material], "COLOR_0" in part.attributes, texture, three));
  };
  const found = { root: new three.Group(), camera: null, lights: [], extras: json.scenes[0].extras };
  const place = (index, parent) => {
    const node = json.nodes[index];
    const matrix = new three.Matrix4().fromArray(node.matrix ?? new three.Matrix4().elements);
    if (node.camera !== undefined) found.camera = { lens: json.cameras[node.camera].perspective, matrix };
    const light = node.extensions?.[LIGHTS]?.light;
    if (light !== undefined) found.lights.push({ ...json.extensions[LIGHTS].lights[light], matrix });
    const object = node.mesh === undefined ? new three.Group() : mesh(json.meshes[node.mesh]);
    object.applyMatrix4(matrix);
    parent.add(object);
    for (const child of node.children ?? []) place(child, object);
  };
  for (const index of json.scenes[0].nodes) place(index, found.root);
  return found;
}

function bitmap(data, type) {
  const plain = { premultiplyAlpha: "none", colorSpaceConversion: "none" };
  return createImageBitmap(new Blob([data], { type }), plain);
}

function material(given, vertexColors, texture, three) {
  const reflecting = given.pbrMetallicRoughness;
  const [red, green, blue, opacity] = reflecting.baseColorFactor;
  const rough = texture(reflecting.metallicRoughnessTexture, false);
  const strength = given.extensions?.KHR_materials_emissive_strength?.emissiveStrength ?? 1;
  const made = new three.MeshStandardMaterial({
    color: new three.Color().setRGB(red, green, blue),
    map: texture(reflecting.baseColorTexture, true),
    metalness: reflecting.metallicFactor,
    roughness: reflecting.roughnessFactor,
    metalnessMap: rough,
    roughnessMap: rough,
    normalMap: texture(given.normalTexture, false),
    aoMap: texture(given.occlusionTexture, false),
    aoMapIntensity: given.occlusionTexture?.strength ?? 1,
    emissive: new three.Color().setRGB(...(given.emissiveFactor ?? [0, 0, 0])),
    emissiveIntensity: strength,
    emissiveMap: texture(given.emissiveTexture, true),
    side: given.doubleSided ? three.DoubleSide : three.FrontSide,
    transparent: given.alphaMode === "BLEND",
    opacity: given.alphaMode === "BLEND" ? opacity : 1,
    alphaTest: given.alphaMode === "MASK" ? given.alphaCutoff : 0,
    depthWrite: given.alphaMode !== "BLEND",
    vertexColors,
  });
  made.normalScale.setScalar(given.normalTexture?.scale ?? 1);
  return made;
}
