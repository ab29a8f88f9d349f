// Files that the page writes to the browser's downloads.

/** Save a Blob under a name. */
export function saveBlob(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  // The browser reads the URL after this turn of the event loop.
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

export const saveText = (name, text) => saveBlob(name, new Blob([text], { type: "text/plain;charset=utf-8" }));
