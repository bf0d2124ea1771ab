// Lets the keyboard reach what scrolls sideways, in browsers that do not do so themselves. What fits is no stop for it.
"use strict";

const SCROLLERS = ".scroll, pre";

function mark() {
  for (const one of document.querySelectorAll(SCROLLERS)) {
    if (one.scrollWidth > one.clientWidth) one.tabIndex = 0;
    else one.removeAttribute("tabindex");
  }
}

mark();
addEventListener("resize", mark);
document.addEventListener("toggle", mark, true);
new MutationObserver(mark).observe(document.getElementById("content"), { childList: true, subtree: true });
