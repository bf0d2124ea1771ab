// What the viewer draws on its canvas.

const NUMBERS_FROM = 44; // from this size on, each pixel has its values written in it

// Draws an image in a pane that begins at `shift`, between `from` and `to` of the canvas.
export function paint(context, image, pane, shift, from, to) {
  context.save();
  context.beginPath();
  context.rect(from, 0, Math.max(0, to - from), pane.height);
  context.clip();
  context.imageSmoothingEnabled = pane.scale < 1;
  const { width, height } = image.canvas;
  context.drawImage(image.canvas, shift + pane.x, pane.y, width * pane.scale, height * pane.scale);
  if (pane.scale >= NUMBERS_FROM) number(context, image, pane, shift);
  context.restore();
}

function number(context, image, pane, shift) {
  const { width, height } = image.canvas;
  context.font = `${Math.round(pane.scale / 4.2)}px monospace`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (let row = Math.max(0, Math.floor(-pane.y / pane.scale)); row < height; row++) {
    const y = pane.y + row * pane.scale;
    if (y > pane.height) break;
    for (let column = Math.max(0, Math.floor(-pane.x / pane.scale)); column < width; column++) {
      const x = shift + pane.x + column * pane.scale;
      if (x > shift + pane.width) break;
      const values = image.data.subarray(4 * (row * width + column), 4 * (row * width + column) + 3);
      context.fillStyle = 0.299 * values[0] + 0.587 * values[1] + 0.114 * values[2] > 140 ? "#000" : "#fff";
      values.forEach((value, k) => context.fillText(value, x + pane.scale / 2, y + (pane.scale * (2 * k + 1)) / 6));
    }
  }
}

export function drawDivider(context, x, height) {
  context.fillStyle = "#000a";
  context.fillRect(x - 2, 0, 4, height);
  context.fillStyle = "#fff";
  context.fillRect(x - 1, 0, 2, height);
  context.beginPath();
  context.arc(x, height / 2, 13, 0, 2 * Math.PI);
  context.fill();
  context.fillStyle = "#000";
  context.font = "14px sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText("↔", x, height / 2);
}
