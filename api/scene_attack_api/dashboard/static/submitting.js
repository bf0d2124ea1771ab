// Says at once that a form is being sent: its buttons wait, the pressed one says for what, and so does a status line.
const status = document.getElementById("submitting");
const sent = new Set(); // what ends each that is under way

// Marks a form as being sent by one of its buttons, whose `data-busy` says what the service does meanwhile. Returns
// what ends that.
export function busy(form, pressed) {
  const buttons = [...form.elements].filter((one) => one.type === "submit" && !one.disabled);
  const before = pressed?.textContent;
  const said = pressed?.dataset.busy ?? "Sending…";
  for (const button of buttons) button.disabled = true;
  if (pressed) pressed.textContent = said;
  form.setAttribute("aria-busy", "true");
  status.textContent = said;
  const end = () => {
    for (const button of buttons) button.disabled = false;
    if (pressed) pressed.textContent = before;
    form.removeAttribute("aria-busy");
    status.textContent = "";
    sent.delete(end);
  };
  sent.add(end);
  return end;
}

document.addEventListener("submit", (event) => {
  const { target: form, submitter } = event;
  const method = submitter?.formMethod || form.method;
  if (event.defaultPrevented || method !== "post") return; // a script sends it, or the answer may be a file
  // Not before the browser has read the form: a disabled button is no part of it.
  setTimeout(() => busy(form, submitter));
});
// The browser may show this page again as it was left.
addEventListener("pageshow", () => {
  for (const end of sent) end();
});
