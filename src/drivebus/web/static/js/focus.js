// Keyboard focus stays near its place: where the focused element is removed or disabled, the nearest section that remains
// takes the focus. The browser itself would give it to the body, and the next Tab would begin at the top of the page.

const SECTIONS = "li, section, article, dialog, main, footer, .notices";

/** The focused element and the sections around it, nearest first. */
let path = [];

/** Whether the element can still have the focus. */
const isUsable = (element) => element.isConnected && !element.disabled
  && (element.tabIndex >= 0 || element.hasAttribute("tabindex"));

const sectionAround = (element) => element.parentElement?.closest(SECTIONS);

function remember({ target }) {
  path = [target];
  for (let section = sectionAround(target); section; section = sectionAround(section)) path.push(section);
}

/** The focus left an element: to another one, to the ground of the page by a click, or because it became unusable. */
function onFocusOut({ target }) {
  setTimeout(() => {
    if (path[0] !== target) return;
    if (isUsable(target)) path = [];
    else restore();
  });
}

function restore() {
  if (path.length === 0 || isUsable(path[0]) || (document.activeElement ?? document.body) !== document.body) return;
  const next = path.slice(1).find((section) => section.isConnected);
  if (!next) return;
  if (!next.hasAttribute("tabindex")) next.tabIndex = -1;
  next.focus({ preventScroll: true });
  // A row that has moved away is followed where the keyboard is used; under a pointer the page stays where it is.
  if (next.matches("li:focus-visible, article:focus-visible")) next.scrollIntoView({ block: "nearest" });
}

export function keepFocus() {
  addEventListener("focusin", remember);
  addEventListener("focusout", onFocusOut);
  new MutationObserver(restore).observe(document.body, { childList: true, subtree: true });
}
