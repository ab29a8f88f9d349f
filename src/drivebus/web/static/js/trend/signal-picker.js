// Picker of signals by drive and name.
import { html, useState } from "../lib.js";
import { localized, hasKey, t } from "../i18n.js";
import { signalName } from "../signal-names.js";
import { SearchField, hasWords } from "../search.js";
import { Button, toggled } from "../ui.js";
import { driveTitle } from "../titles.js";

/** Name of a signal: the catalogue's, else the profile's. */
const tagName = (tag) => (hasKey(`signal.${tag.signal}`) ? signalName(tag.signal) : localized(tag.text)
  || signalName(tag.signal));

/** "Fan 1 · output frequency". */
export const labelOf = (tag) => `${driveTitle(tag.drive)} · ${tagName(tag)}`;

/** Drives listed at once; the others are found by searching. */
const MAX_LISTED_DRIVES = 40;

export function SignalPicker({ tags, picked, most, onChange }) {
  const [search, setSearch] = useState("");
  const [isOpen, setOpen] = useState(picked.length === 0);
  const byDrive = grouped(tags.filter((tag) => hasWords(`${tag.tag} ${labelOf(tag)} ${tag.unit}`, search)));
  const full = picked.length >= most;
  return html`<details class="panel picker" open=${isOpen} onToggle=${(event) => setOpen(event.currentTarget.open)}>
    <summary>${t("page.signals_chosen", { n: picked.length })}</summary>
    <div class="filters"><${SearchField} value=${search} onChange=${setSearch} />
      <${Button} disabled=${picked.length === 0} onClick=${() => onChange([])}>${t("page.pick_none")}<//></div>
    ${full && html`<p class="help" role="status">${t("page.pick_full", { n: most })}</p>`}
    ${isOpen && html`<div class="pickdrives">${[...byDrive].slice(0, MAX_LISTED_DRIVES).map(([id, some]) => html`<fieldset
      key=${id}><legend>${driveTitle(id)}</legend>
      ${some.map((tag) => html`<label class="check" key=${tag.tag}><input type="checkbox"
        checked=${picked.includes(tag.tag)}
        disabled=${full && !picked.includes(tag.tag)} onChange=${() => onChange(toggled(picked, tag.tag))} />
        <span>${tagName(tag)} ${tag.unit && html`<span class="unit">${tag.unit}</span>`}</span>
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
