// Tabs of a page; an error in one of them leaves the others at work.
import { html, useId, useRef } from "./lib.js";
import { ErrorBoundary } from "./error-boundary.js";

const TabContent = ({ render }) => render();

/** `tabs` is [[name, title, render]…]; arrows move between them. */
export function Tabs({ label, tabs, value, onChange }) {
  const id = useId();
  const row = useRef(null);
  const move = (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const at = tabs.findIndex(([name]) => name === value);
    const next = (at + step + tabs.length) % tabs.length;
    onChange(tabs[next][0]);
    row.current.children[next].focus();
  };
  const shown = tabs.find(([name]) => name === value) ?? tabs[0];
  return html`<div class="tabs"><div class="tabrow" role="tablist" aria-label=${label} ref=${row} onKeyDown=${move}>
    ${tabs.map(([name, title]) => html`<button type="button" role="tab" key=${name} id=${`${id}-${name}`}
      aria-selected=${name === shown[0] ? "true" : "false"} aria-controls=${`${id}-panel`}
      tabindex=${name === shown[0] ? 0 : -1} onClick=${() => onChange(name)}>${title}</button>`)}</div>
    <div role="tabpanel" id=${`${id}-panel`} aria-labelledby=${`${id}-${shown[0]}`} key=${shown[0]}>
      <${ErrorBoundary}><${TabContent} render=${shown[2]} /><//></div></div>`;
}
