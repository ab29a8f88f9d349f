// Filter of lists of the past by time range and drive.
import { html } from "./lib.js";
import { t } from "./i18n.js";
import { idsOf, serviceNow } from "./store.js";
import { Field } from "./ui.js";
import { driveTitle } from "./titles.js";

const HOUR_MS = 3_600_000;
/** Name → how long ago it begins; "all" has no beginning. */
const SPANS = { hour: HOUR_MS, shift: 8 * HOUR_MS, day: 24 * HOUR_MS, week: 168 * HOUR_MS, month: 720 * HOUR_MS,
  all: null };

/** Query of a choice at this moment: `{from_ms, to_ms, drive}`; null where it does not filter. */
export function timeRangeQuery({ span = "all", from = null, to = null, drive: id = "" }) {
  const since = SPANS[span];
  const begin = span === "own" ? from : since == null ? null : Math.floor(serviceNow() - since);
  return { from_ms: begin, to_ms: span === "own" ? to : null, drive: id || null };
}

/** `value` is the choice that `timeRangeQuery` takes; `onChange` gets the changed choice. */
export function TimeRange({ value, onChange, children }) {
  const set = (change) => onChange({ ...value, ...change });
  const begin = (span) => set(span === "own" ? { span, from: serviceNow() - HOUR_MS, to: serviceNow() } : { span,
    from: null, to: null });
  return html`<div class="filters">
    <${Field} label=${t("page.time_range")}><select value=${value.span ?? "all"}
      onChange=${(event) => begin(event.target.value)}>
      ${[...Object.keys(SPANS), "own"].map((name) => html`<option key=${name}
        value=${name}>${t(`page.period_${name}`)}</option>`)}</select><//>
    ${value.span === "own" && html`<${Moment} label=${t("page.from")} value=${value.from}
      onChange=${(from) => set({ from })} />
      <${Moment} label=${t("page.to")} value=${value.to} onChange=${(to) => set({ to })} />`}
    <${DriveChoice} value=${value.drive ?? ""} onChange=${(id) => set({ drive: id })} />
    ${children}</div>`;
}

/** Text of a moment for an input of type datetime-local, in local time. */
function forInput(at) {
  const local = new Date(at - new Date(at).getTimezoneOffset() * 60_000);
  return local.toISOString().slice(0, 19);
}

/** A date and time of this browser's zone, as UTC milliseconds. */
function Moment({ label, value, onChange }) {
  const changed = (event) => {
    const at = new Date(event.target.value).getTime();
    if (Number.isFinite(at)) onChange(at);
  };
  return html`<${Field} label=${label}><input type="datetime-local" step="1" value=${forInput(value)}
    onChange=${changed} /><//>`;
}

function DriveChoice({ value, onChange }) {
  return html`<${Field} label=${t("page.drive")}><select value=${value}
    onChange=${(event) => onChange(event.target.value)}>
    <option value="">${t("page.every_drive")}</option>
    ${idsOf("drives").value.map((id) => html`<option key=${id} value=${id}>${driveTitle(id)}</option>`)}</select><//>`;
}
