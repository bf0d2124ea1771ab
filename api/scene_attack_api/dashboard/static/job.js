// The page of one job: its viewer, and buttons that copy a text.
import "./viewer.js";

async function copied(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    // No clipboard over http from another machine, or none allowed: the old way, with a selection.
    const area = document.createElement("textarea");
    area.value = text;
    area.className = "sr";
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done;
  }
}

document.addEventListener("click", async (event) => {
  const button = event.target.closest?.("button[data-copy]");
  if (!button) return;
  const of = button.dataset.copy;
  const text = of.startsWith("#") ? document.querySelector(of).textContent : of;
  const done = await copied(text);
  button.focus();
  const status = document.getElementById("copied");
  status.textContent = done ? `Copied ${button.dataset.what}` : "The browser does not allow to copy; select the text instead.";
  button.classList.toggle("done", done);
  setTimeout(() => button.classList.remove("done"), 2000);
});
