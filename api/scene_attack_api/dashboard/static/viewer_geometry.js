// The arithmetic of the viewer, without the page.

// 128 + gain · (after − before), clipped to 0…255, of two images as RGBA bytes.
export function differences(before, after, gain) {
  const found = new Uint8ClampedArray(before.length);
  for (let i = 0; i < before.length; i++) found[i] = i % 4 === 3 ? 255 : 128 + gain * (after[i] - before[i]);
  return found;
}

const between = (value, low, high) => Math.min(Math.max(value, low), high);

// Where an image lies in a pane of `width` and `height`: `scale` in screen pixels per pixel, and the corner (x, y).
// `state.scale` null fits the whole image; else (state.left, state.top) is the image's point at the pane's corner.
// `kept` is that point once it is so bounded that the pane shows nothing beside an image that fills it.
export function fitted(image, width, height, state) {
  const whole = Math.min(width / image.width, height / image.height);
  const scale = state.scale ?? whole;
  const along = (start, size, room) => {
    const visible = room / scale;
    return visible >= size ? (size - visible) / 2 : between(state.scale === null ? 0 : start, 0, size - visible);
  };
  const left = along(state.left, image.width, width);
  const top = along(state.top, image.height, height);
  return { width, height, whole, scale, x: -left * scale, y: -top * scale, kept: { left, top } };
}

// The state after a zoom by `factor` that leaves the image's point at (x, y) of the pane where it is.
export function zoomedAt(pane, x, y, factor, largest) {
  const scale = between(pane.scale * factor, pane.whole, Math.max(largest, pane.whole));
  if (scale <= pane.whole * 1.0001) return { scale: null, left: 0, top: 0 };
  const [column, row] = [(x - pane.x) / pane.scale, (y - pane.y) / pane.scale];
  return { scale, left: column - x / scale, top: row - y / scale };
}
