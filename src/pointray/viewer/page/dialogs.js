/** Dialogs: a text to copy, the help; and files to save. */

const byId = (id) => document.getElementById(id);

/** Puts the shown text on the clipboard; whether the browser let it. */
async function copyShown() {
  const field = byId("copy-text");
  field.select();
  try {
    await navigator.clipboard.writeText(field.value);
    return true;
  } catch {
    return document.execCommand("copy"); // for pages that are not from this machine, by http
  }
}

async function copyAndTell() {
  const copied = await copyShown();
  byId("copy-state").textContent = copied ? "Copied." : "The browser does not allow it: press Ctrl+C.";
}

/** Shows a text, selected, and tries to put it on the clipboard. */
export function showCopy({ text, title = "Copy" }) {
  const dialog = byId("copy");
  byId("copy-title").textContent = title;
  byId("copy-text").value = text;
  if (!dialog.open) dialog.showModal();
  copyAndTell();
}

/** The buttons of both dialogs; once. */
export function prepareDialogs() {
  byId("copy-copy").addEventListener("click", copyAndTell);
  for (const button of document.querySelectorAll("dialog .dismiss")) {
    button.addEventListener("click", () => button.closest("dialog").close());
  }
}

/** Not modal: one can try the keys while reading them. */
export function toggleHelp() {
  const help = byId("help");
  if (help.open) return help.close();
  help.show();
  document.activeElement?.blur(); // of its button
}

/** Whether there was a help box to close. */
export function closeHelp() {
  const { open } = byId("help");
  byId("help").close();
  return open;
}

/** Saves a file as a download. */
export function saveFile({ name = "pointray", mime = "application/octet-stream" }, payload) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([payload], { type: mime }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000); // the browser may still be reading
}
