// Keeps the part of the page that changes (#live) up to date: asks the service for it again when there is news.
"use strict";

const live = document.getElementById("live");
const connection = document.getElementById("connection");

// Puts the new part in place; what the reader has opened, chosen or focused stays so.
function replace(html) {
  const next = document.createElement("div");
  next.innerHTML = html;
  patch(live, next);
}

let last = "";
async function refresh() {
  try {
    const response = await fetch(live.dataset.part, { headers: { Accept: "text/html" } });
    if (response.status === 401) return location.reload(); // the session has ended: the page asks to sign in
    if (!response.ok) throw new Error(String(response.status));
    const html = await response.text();
    if (html !== last) replace(html);
    last = html;
    connection.hidden = true;
  } catch {
    connection.hidden = false;
  }
}

// At most one question at a time, and at most one in `pause` milliseconds.
function throttled(action, pause) {
  let waiting = false;
  let again = false;
  return async function run() {
    if (waiting) {
      again = true;
      return;
    }
    waiting = true;
    await action();
    await new Promise((done) => setTimeout(done, pause));
    waiting = false;
    if (again) {
      again = false;
      run();
    }
  };
}

const update = throttled(refresh, live?.dataset.events ? 700 : 0);
if (live?.dataset.events) {
  const source = new EventSource(live.dataset.events);
  source.addEventListener("progress", update);
  source.addEventListener("state", (event) => {
    update();
    if (["succeeded", "failed", "rejected", "cancelled"].includes(JSON.parse(event.data).state)) source.close();
  });
  source.addEventListener("error", () => {
    connection.hidden = false;
    update();
  });
  source.addEventListener("open", () => {
    connection.hidden = true;
  });
}
if (live?.dataset.poll) {
  setInterval(() => {
    if (!document.hidden) update();
  }, Number(live.dataset.poll));
}
