// Style sheets of single pages: loaded with the page's module, before it is drawn.
const stylesheetUrls = new Map();

/** Load `/static/css/<name>.css`; resolves also where it cannot be loaded, because the page is usable without it. */
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
