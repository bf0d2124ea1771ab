// Plots of points: a key hides and shows its series, and the point nearest to the pointer is read out below.
"use strict";

const REACH = 24; // SVG units

function near(svg, event) {
  const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  let best = null;
  let least = REACH;
  for (const mark of svg.querySelectorAll("g:not([display]) > .mark")) {
    const { e, f } = mark.transform.baseVal.consolidate().matrix;
    const away = Math.hypot(e - at.x, f - at.y);
    if (away < least) [best, least] = [mark, away];
  }
  return best;
}

for (const plot of document.querySelectorAll(".scatter")) {
  const svg = plot.querySelector(":scope > svg");
  const read = plot.querySelector(".read");
  for (const box of plot.querySelectorAll("[data-series]")) {
    const points = plot.querySelector(`[data-points="${box.dataset.series}"]`);
    box.addEventListener("change", () => {
      if (box.checked) points.removeAttribute("display");
      else points.setAttribute("display", "none");
    });
  }
  svg.addEventListener("pointermove", (event) => {
    const mark = near(svg, event);
    svg.querySelector(".near")?.classList.remove("near");
    mark?.classList.add("near");
    if (mark) read.textContent = mark.querySelector("title").textContent;
  });
}
