// Style sheets of single pages: loaded with the page's module, before it is drawn.
/** Address → promise of its end. */
const loadings = new Map();

/** Load `/static/css/<name>.css`, or an address; resolves also where it cannot be loaded, because the page is usable without it. */
export function loadStylesheet(name) {
  const address = name.startsWith("/") ? name : `/static/css/${name}.css`;
  if (!loadings.has(address)) loadings.set(address, addLink(address));
  return loadings.get(address);
}

function addLink(address) {
  const link = document.createElement("link");
  link.rel = "stylesheet";
  link.href = address;
  const done = new Promise((resolve) => { link.onload = link.onerror = resolve; });
  document.head.append(link);
  return done;
}
