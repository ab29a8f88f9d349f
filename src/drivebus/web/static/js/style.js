// Style sheets that only some pages need: loaded with the page's module, before it is drawn.
const stylesheetUrls = new Map();

/** Resolves when `/static/css/<name>.css` is in force; a page without it is still usable. */
export function styled(name) {
  if (!stylesheetUrls.has(name)) stylesheetUrls.set(name, loaded(name.startsWith("/") ? name : `/static/css/${name}.css`));
  return stylesheetUrls.get(name);
}

function loaded(address) {
  const link = document.createElement("link");
  link.rel = "stylesheet";
  link.href = address;
  const done = new Promise((resolve) => { link.onload = link.onerror = resolve; });
  document.head.append(link);
  return done;
}
