// Search in lists: its input, and whether a text fits.
import { html } from "./lib.js";
import { t } from "./i18n.js";
import { Field } from "./ui.js";

export const SearchField = ({ label = t("page.search"), help, value, onChange, ...rest }) => html`<${Field} label=${label} help=${help}>
  <input type="search" spellcheck=${false} placeholder=" " value=${value} onInput=${(event) => onChange(event.currentTarget.value)} ...${rest} /><//>`;

/** Whether every word of a search is in a text. */
export function hasWords(text, search) {
  const found = text.toLowerCase();
  return search.toLowerCase().split(/\s+/).every((word) => found.includes(word));
}
