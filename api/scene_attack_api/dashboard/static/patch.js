// Makes the children of an element like those of another, in place. What is unchanged stays the same node, so that
// focus, selection, scroll positions, running media and what the reader has typed or opened are kept.
// Elements with `data-own` belong to a script: they and all they contain stay as they are.
"use strict";

const keyOf = (node) => node.id || node.getAttribute?.("aria-labelledby") || "";
const alike = (one, other) => one.nodeName === other.nodeName && keyOf(one) === keyOf(other);

// The child of an element, at or after `from`, that is to become like `child`; null if a new one has to be made.
function counterpart(child, from) {
  if (from && alike(from, child)) return from;
  if (child.nodeType !== Node.ELEMENT_NODE) return null;
  for (let node = from; node; node = node.nextSibling) {
    if (alike(node, child) && (keyOf(child) || node.className === child.className)) return node;
  }
  return null;
}

function patchAttributes(old, next) {
  for (const { name, value } of next.attributes) {
    if (old.getAttribute(name) !== value) old.setAttribute(name, value);
  }
  for (const { name } of [...old.attributes]) {
    const opened = name === "open" && old.nodeName === "DETAILS"; // by the reader
    if (!opened && !next.hasAttribute(name)) old.removeAttribute(name);
  }
}

function patch(old, next) {
  const needed = new Set([...next.children].map(keyOf).filter(Boolean));
  let at = old.firstChild;
  for (const child of [...next.childNodes]) {
    const match = counterpart(child, at);
    if (!match) {
      old.insertBefore(child, at);
      continue;
    }
    while (at !== match && !needed.has(keyOf(at))) {
      const gone = at;
      at = at.nextSibling;
      gone.remove();
    }
    if (at !== match) old.insertBefore(match, at);
    else at = at.nextSibling;
    if (match.nodeType !== Node.ELEMENT_NODE) {
      if (match.data !== child.data) match.data = child.data;
    } else if (!match.hasAttribute("data-own")) {
      patchAttributes(match, child);
      patch(match, child);
    }
  }
  while (at) {
    const gone = at;
    at = at.nextSibling;
    gone.remove();
  }
}
