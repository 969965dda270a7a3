/** Dialogs (text to copy, help) and downloads. */

const byId = (id) => document.getElementById(id);

/** Copy the shown text to the clipboard; return whether the browser allowed it. */
async function copyShown() {
  const field = byId("copy-text");
  field.select();
  try {
    await navigator.clipboard.writeText(field.value);
    return true;
  } catch {
    return document.execCommand("copy"); // pages over http from other machines have no clipboard API
  }
}

async function copyAndTell() {
  const copied = await copyShown();
  byId("copy-state").textContent = copied ? "Copied." : "The browser blocked it: press Ctrl+C.";
}

/** Show a text, selected, and try to copy it to the clipboard. */
export function showCopy({ text, title = "Copy" }) {
  const dialog = byId("copy");
  byId("copy-title").textContent = title;
  byId("copy-text").value = text;
  if (!dialog.open) dialog.showModal();
  copyAndTell();
}

/** Connect the buttons of both dialogs; call once. */
export function prepareDialogs() {
  byId("copy-copy").addEventListener("click", copyAndTell);
  for (const button of document.querySelectorAll("dialog .dismiss")) {
    button.addEventListener("click", () => button.closest("dialog").close());
  }
}

/** Not modal, so that keys can be tried while the help is open. */
export function toggleHelp() {
  const help = byId("help");
  if (help.open) return help.close();
  help.show();
  document.activeElement?.blur(); // removes focus from its button
}

/** Close the help; return whether it was open. */
export function closeHelp() {
  const { open } = byId("help");
  byId("help").close();
  return open;
}

/** Save a file as a download. */
export function saveFile({ name = "pointray", mime = "application/octet-stream" }, payload) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([payload], { type: mime }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000); // the browser may still be reading
}
