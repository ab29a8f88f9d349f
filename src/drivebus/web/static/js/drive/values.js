// Live values of one drive, the most used first, each with its age.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { duration, number } from "../format.js";
import { reading, slowInterval } from "../readings.js";
import { signalName, signalRank } from "../signal-names.js";
import { isLive } from "../live.js";
import { bus } from "../store.js";
import { Value } from "../ui.js";

const LARGE_SIGNALS = ["output_frequency", "output_current"];
/** Rows shown at first; the others open by a press, because some models have twenty. */
const DEFAULT_ROW_COUNT = 5;

const signalsOf = (view) => Object.keys(view.signals).sort((a, b) => signalRank(a) - signalRank(b));

/** Reason why a value is uncertain or absent, shown without a pointer. The row has its place also without one. */
function QualityReason({ found }) {
  if (!found?.reason || (found.quality === "bad" && found.age_s !== null)) return null;
  return html`<small class="reason" aria-hidden="true"><span>${t(found.reason)}</span></small>`;
}

function Row({ view, name }) {
  const found = reading(view, name);
  return html`<tr><th scope="row"><div class="signal">${signalName(name)}<${QualityReason} found=${found} /></div></th><td class="right"><${Value} found=${found} /></td>
    <td class="right soft">${duration(found.age_s)}</td></tr>`;
}

function Rows({ view, names }) {
  return html`<table class="data"><caption class="sr">${t("page.values")}</caption>
    <thead><tr><th scope="col">${t("page.signal")}</th><th scope="col" class="right">${t("page.value")}</th>
      <th scope="col" class="right">${t("page.age")}</th></tr></thead>
    <tbody>${names.map((name) => html`<${Row} key=${name} view=${view} name=${name} />`)}</tbody></table>`;
}

/** Note where the bus polls the drive less often than its model asks for. */
function SlowPolling({ view }) {
  const slow = slowInterval(view);
  if (slow === null) return null;
  const n = bus(view.bus).value?.stations.length ?? 1;
  return html`<p class="hint" data-text="slow-polling">${t("page.polled_slowly", {
    n, interval: duration(slow), requested: duration(view.requested_interval_s) })}</p>`;
}

export function Values({ view }) {
  const names = signalsOf(view);
  const more = names.slice(DEFAULT_ROW_COUNT);
  return html`<section class="panel stack values" aria-labelledby="values-title"><h2 id="values-title">
    ${t("page.values")}</h2>
    <div class="bigvalues">${LARGE_SIGNALS.filter((name) => names.includes(name)).map((name) => html`<figure key=${name}>
      <figcaption>${signalName(name)}</figcaption><${Value} found=${reading(view, name)} big brief /></figure>`)}
      <figure><figcaption>${t("page.commanded")}</figcaption><span
        class=${`value big ${isLive.value ? "" : "bad"}`}><span class="number">${
        number(view.commanded_hz, "Hz")}</span><span class="unit">${view.commanded_hz === null ? "" : "Hz"}</span>
        </span></figure></div>
    <${SlowPolling} view=${view} /><${Rows} view=${view} names=${names.slice(0, DEFAULT_ROW_COUNT)} />
    ${more.length > 0 && html`<details><summary>${t("page.more_values", { n: more.length })}</summary>
      <${Rows} view=${view} names=${more} /></details>`}</section>`;
}
