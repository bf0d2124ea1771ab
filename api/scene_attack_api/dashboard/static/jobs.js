// Keeps the list of jobs up to date, row by row, so that focus, ticks and scroll stay; keys; the choice of columns.
const root = document.getElementById("jobs");
const connection = document.getElementById("connection");
const said = document.getElementById("said");
const rowsOf = (part) => part.querySelector("#rows");
const served = new Map(); // job: the HTML of its cells as the service wrote it

function remember(part) {
  for (const row of part.querySelectorAll("#rows > tr")) served.set(row.dataset.id, [...row.cells].map((c) => c.innerHTML));
}

function patchRow(row, next) {
  const cells = [...next.cells].map((c) => c.innerHTML);
  const before = served.get(row.dataset.id) ?? [];
  cells.forEach((html, k) => {
    if (k > 0 && html !== before[k]) row.cells[k].innerHTML = html; // the first has the tick, which is the reader's
  });
  served.set(row.dataset.id, cells);
}

function patchRows(rows, next) {
  const there = new Map([...rows.rows].map((row) => [row.dataset.id, row]));
  const listed = new Set([...next.rows].map((row) => row.dataset.id));
  const kept = new Set(); // jobs that are not in the list any more, but that the reader has ticked or is at
  for (const row of there.values()) {
    if (listed.has(row.dataset.id)) continue;
    if (row.contains(document.activeElement) || row.querySelector("input:checked")) kept.add(row);
    else row.remove();
  }
  let at = rows.firstElementChild;
  for (const fresh of [...next.rows]) {
    while (kept.has(at)) at = at.nextElementSibling;
    const row = there.get(fresh.dataset.id);
    if (row === undefined) {
      served.set(fresh.dataset.id, [...fresh.cells].map((c) => c.innerHTML));
      rows.insertBefore(fresh, at);
      continue;
    }
    patchRow(row, fresh);
    if (row === at) at = at.nextElementSibling;
    else if (!row.contains(document.activeElement)) rows.insertBefore(row, at); // a move would lose the focus
  }
}

function patch(part) {
  const rows = rowsOf(root);
  const next = rowsOf(part);
  if (!rows || !next) {
    root.replaceChildren(...part.childNodes);
    remember(root);
    begin();
    return;
  }
  for (const name of ["strip", "error", "refused", "totals", "pages"]) {
    const old = root.querySelector(`[data-keep=${name}]`);
    const fresh = part.querySelector(`[data-keep=${name}]`);
    if (old && fresh) {
      if (old.innerHTML !== fresh.innerHTML) old.innerHTML = fresh.innerHTML;
    } else if (fresh) root.querySelector("[data-keep=strip]").after(fresh);
    else old?.remove();
  }
  patchRows(rows, next);
  count();
}

const parsed = (html) => new DOMParser().parseFromString(html, "text/html");

let busy = false;
async function refresh() {
  if (busy || document.hidden) return;
  busy = true;
  try {
    const response = await fetch(root.dataset.part + location.search, { headers: { Accept: "text/html" } });
    if (response.status === 401) return location.reload(); // the session has ended: the page asks to sign in
    if (!response.ok && response.status !== 422) throw new Error(String(response.status));
    patch(parsed(await response.text()).body);
    connection.hidden = true;
  } catch {
    connection.hidden = false;
  }
  busy = false;
}

const ticks = () => [...root.querySelectorAll("#rows input:checked")];
function count() {
  const n = ticks().length;
  const text = document.getElementById("ticked");
  if (!text) return;
  text.textContent = n ? `${n} ticked` : "";
  for (const button of root.querySelectorAll(".actions [name=action]")) button.disabled = n === 0;
  document.getElementById("compare").disabled = n < 2;
}

async function submit(event) {
  const button = event.submitter;
  if (!button || button.name !== "action") return;
  event.preventDefault();
  const n = ticks().length;
  if (button.value === "delete" && !confirm(`Delete ${n === 1 ? "this job" : `these ${n} jobs`} and all files?`)) return;
  const body = new URLSearchParams(new FormData(event.target));
  body.set("action", button.value);
  try {
    const address = event.target.getAttribute("action"); // its property is the buttons of that name
    const response = await fetch(address, { method: "POST", body, headers: { Accept: "text/html" } });
    const part = parsed(await response.text()).getElementById("jobs");
    if (!part) return location.reload(); // the session has ended, or the service cannot answer: its page says so
    for (const tick of ticks()) tick.checked = false;
    patch(part);
    said.textContent = part.querySelector("[data-keep=refused]")?.textContent ?? `${button.textContent}: done`;
  } catch {
    connection.hidden = false;
  }
}

// Columns
const CHOSEN = "scene-attack.columns";
function chosen() {
  try {
    return JSON.parse(localStorage.getItem(CHOSEN)) ?? {};
  } catch {
    return {};
  }
}
function choose() {
  const table = document.getElementById("table");
  const boxes = [...document.querySelectorAll("#columns input")];
  for (const box of boxes) table?.classList.toggle(`hide-${box.value}`, !box.checked);
}
function columns() {
  const details = document.getElementById("columns");
  details.hidden = false;
  const choice = chosen();
  for (const box of details.querySelectorAll("input")) if (box.value in choice) box.checked = choice[box.value];
  details.addEventListener("change", () => {
    const boxes = [...details.querySelectorAll("input")];
    localStorage.setItem(CHOSEN, JSON.stringify(Object.fromEntries(boxes.map((box) => [box.value, box.checked]))));
    choose();
  });
}

// Keys
function move(by) {
  const links = [...root.querySelectorAll("#rows .c-name > a:first-child")];
  const row = document.activeElement.closest?.("#rows > tr");
  const at = links.findIndex((link) => row?.contains(link));
  links[at < 0 ? 0 : Math.min(Math.max(at + by, 0), links.length - 1)]?.focus();
}
const KEYS = {
  "/": () => document.getElementById("q").focus(),
  j: () => move(1),
  k: () => move(-1),
  x: () => document.activeElement.closest?.("#rows > tr")?.querySelector("input")?.click(),
  c: () => document.getElementById("compare")?.click(),
  "?": () => document.getElementById("keys").showModal(),
};
document.addEventListener("keydown", (event) => {
  const writes = event.target.matches?.("input:not([type=checkbox]), textarea, select");
  if (writes || event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  const action = KEYS[event.key];
  if (!action) return;
  event.preventDefault();
  action();
});

function begin() {
  document.getElementById("selection")?.addEventListener("submit", submit);
  choose();
  count();
}
root.addEventListener("change", count);
columns();
remember(root);
begin();

setInterval(refresh, 3000);
document.addEventListener("visibilitychange", refresh);
