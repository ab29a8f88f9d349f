// Picker of signals by drive and name.
import { html, useState } from "../lib.js";
import { localized, hasKey, t } from "../i18n.js";
import { signalName } from "../format.js";
import { Button, Field } from "../ui.js";
import { driveTitle } from "../titles.js";

/** Name of a signal: the catalogue's, else the profile's. */
export const nameOf = (tag) => (hasKey(`signal.${tag.signal}`) ? signalName(tag.signal) : localized(tag.text)
  || signalName(tag.signal));

/** "Fan 1 · output frequency". */
export const labelOf = (tag) => `${driveTitle(tag.drive)} · ${nameOf(tag)}`;

/** Drives listed at once; the others are found by searching. */
const MAX_LISTED_DRIVES = 40;

export function SignalPicker({ tags, picked, most, onChange }) {
  const [search, setSearch] = useState("");
  const [isOpen, setOpen] = useState(picked.length === 0);
  const words = search.trim().toLowerCase().split(/\s+/).filter(Boolean);
  const fits = (tag) => {
    const text = `${tag.tag} ${labelOf(tag)} ${tag.unit}`.toLowerCase();
    return words.every((word) => text.includes(word));
  };
  const byDrive = grouped(tags.filter(fits));
  const full = picked.length >= most;
  const toggle = (tag) => onChange(picked.includes(tag) ? picked.filter((one) => one !== tag) : [...picked, tag]);
  return html`<details class="panel picker" open=${isOpen} onToggle=${(event) => setOpen(event.currentTarget.open)}>
    <summary>${t("page.signals_chosen", { n: picked.length })}</summary>
    <div class="filters"><${Field} label=${t("page.search")}><input type="search" value=${search}
        onInput=${(event) => setSearch(event.target.value)} /><//>
      <${Button} disabled=${picked.length === 0} onClick=${() => onChange([])}>${t("page.pick_none")}<//></div>
    ${full && html`<p class="help" role="status">${t("page.pick_full", { n: most })}</p>`}
    ${isOpen && html`<div class="pickdrives">${[...byDrive].slice(0, MAX_LISTED_DRIVES).map(([id, some]) => html`<fieldset
      key=${id}><legend>${driveTitle(id)}</legend>
      ${some.map((tag) => html`<label class="check" key=${tag.tag}><input type="checkbox"
        checked=${picked.includes(tag.tag)}
        disabled=${full && !picked.includes(tag.tag)} onChange=${() => toggle(tag.tag)} />
        <span>${nameOf(tag)} ${tag.unit && html`<span class="unit">${tag.unit}</span>`}</span>
          </label>`)}</fieldset>`)}</div>`}
    ${byDrive.size > MAX_LISTED_DRIVES && html`<p class="help">${t("page.pick_more", { n: byDrive.size - MAX_LISTED_DRIVES })}</p>`}
    ${byDrive.size === 0 && html`<p class="help">${t("page.nothing")}</p>`}</details>`;
}

/** Drive → its tags, in their order. */
function grouped(tags) {
  const found = new Map();
  for (const tag of tags) found.set(tag.drive, [...(found.get(tag.drive) ?? []), tag]);
  return found;
}
