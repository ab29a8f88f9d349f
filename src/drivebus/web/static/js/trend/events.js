// Events in the window of a trend: the chart's markers as an accessible list.
import { html, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { driveTitle } from "../titles.js";
import { moment } from "../format.js";

const MAX_EVENTS = 50;
const EVENT_ICONS = { command: "▼", stop: "■", fault: "✕", alarm: "◆", other: "●" };

export function Events({ trend, source }) {
  const [isOpen, setOpen] = useState(false);
  const { items, isCut } = source.markers.value;
  const { from, to } = trend.window.value;
  const inside = items.filter((event) => event.time_ms >= from && event.time_ms <= to);
  const newest = inside.slice(-MAX_EVENTS).reverse();
  return html`<details class="trend-events" open=${isOpen} onToggle=${(event) => setOpen(event.currentTarget.open)}>
    <summary>${t("page.events_in_view", { n: inside.length })}</summary>
    ${isOpen && html`<ol>${newest.map((event) => html`<li key=${event.id}><${EventRow} event=${event} trend=${trend} />
      </li>`)}</ol>`}
    ${isOpen && inside.length > MAX_EVENTS && html`<p class="help">${t("page.events_newest", { n: MAX_EVENTS })}</p>`}
    ${isCut && html`<p class="help">${t("page.events_cut")}</p>`}</details>`;
}

/** Sentence of an event with the title of its drive, which most sentences have themselves. */
export function eventText({ drive, text }) {
  const [title, sentence] = [drive ? driveTitle(drive) : "", localized(text)];
  return sentence.includes(title) ? sentence : `${title} ${sentence}`;
}

/** Whether a sentence has the word for its kind, such as "fault OC: overcurrent": a screen reader would read it twice. */
export const namesKind = (kind, text) => new RegExp(`(^|[^a-z])${t(`page.event_${kind}`)}([^a-z]|$)`, "i").test(localized(text));

/** One event; pressing it puts it in the middle of the chart. */
function EventRow({ event, trend }) {
  const centre = () => trend.show({ from: event.time_ms - trend.span / 2, to: event.time_ms + trend.span / 2 },
    { isStep: true });
  const kind = event.kind in EVENT_ICONS ? event.kind : "other";
  return html`<button type="button" class=${`event event-${kind}`} onClick=${centre}>
    <span class="sign" aria-hidden="true">${EVENT_ICONS[kind]}</span>
    <time>${moment(event.time_ms)}</time>
    ${!namesKind(kind, event.text) && html`<span class="sr">${t(`page.event_${kind}`)}</span>`}
    <span class="what">${eventText(event)}</span>
    ${event.actor && html`<span class="actor">${event.actor}</span>`}</button>`;
}
