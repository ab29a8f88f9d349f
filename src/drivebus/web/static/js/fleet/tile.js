// Tile of one drive. Each tile subscribes to its own drive only.
import { html, useComputed } from "../lib.js";
import { t, titleOf } from "../i18n.js";
import { NO_VALUE, duration } from "../format.js";
import { ageOf, readingWithoutAge, slowInterval, stateOf } from "../readings.js";
import { isCleared, mostUrgentAlarm } from "../alarms/alarm-list.js";
import { PriorityMark } from "../alarms/alarm-state.js";
import { isLive } from "../live.js";
import { Icon } from "../icons.js";
import { Value, ignoreRepeat, withWholeNumbers } from "../ui.js";
import { href } from "../router.js";
import { may } from "../session.js";
import { drive } from "../store.js";
import { stop } from "../control/stops.js";
import { faultText } from "../drive/faults.js";
import { size } from "./fleet-filter.js";
import { LimitBar, Sparkline } from "./sparkline.js";
import { StateMark, appearanceOf } from "../drive/state-mark.js";
import { shortened } from "../titles.js";

/** Letters of a name on the two lines of a dense tile. */
const DENSE_NAME_LENGTH = 24;

/** "< 1 s", "3 s"…: coarse, so that hundreds of tiles are redrawn only for a visible change. */
function coarseAge(seconds) {
  if (seconds === null) return t("page.never_read");
  if (seconds < 1.5) return t("page.age_now");
  if (seconds < 100) return t("page.seconds", { n: Math.floor(seconds) });
  return t("page.minutes", { n: Math.floor(seconds / 60) });
}

/** Age of the frequency, else of the first signal that the drive reports; with the poll interval where that is long. */
function ageText(view) {
  const all = view?.signals ?? {};
  const found = [all.output_frequency, ...Object.values(all)].find((signal) => signal && signal.readAt !== null);
  if (!found) return t("page.never_read");
  const slow = slowInterval(view);
  const age = coarseAge(ageOf(found));
  return slow === null ? age : t("page.age_of_interval", { age, interval: duration(slow) });
}

/** Priority of the drive's most urgent alarm; outlined where its condition no longer holds. */
function AlarmMark({ id }) {
  const shown = useComputed(() => {
    const alarm = mostUrgentAlarm(id);
    return alarm ? `${alarm.priority} ${isCleared(alarm) ? "cleared" : ""}` : "";
  });
  const [priority, cleared] = shown.value.split(" ");
  return priority ? html`<${PriorityMark} priority=${priority} cleared=${cleared === "cleared"} />` : null;
}

function Fault({ fault }) {
  return html`<p class="tilefault">${faultText(fault)}</p>`;
}

/** The current, only where its unit is known. */
function current(view) {
  const found = readingWithoutAge(view, "output_current");
  return found === null || found.value === null || !found.unit ? null : html`<${Value} found=${found} />`;
}

export function Tile({ id }) {
  const topic = drive(id);
  const age = useComputed(() => ageText(topic.value));
  const view = topic.value;
  if (!view) return null;
  const known = stateOf(view);
  const [, tone] = appearanceOf(known);
  const name = titleOf(view);
  const isDense = size.value === "dense";
  return html`<article class=${`tile tone-${tone} ${isLive.value ? "" : "old"}`}>
    <a class="tilelink" href=${href("drive", id)} data-drive=${id}>
      <span class="tilehead"><span class="tilename" title=${name}>${
        withWholeNumbers(isDense ? shortened(name, DENSE_NAME_LENGTH) : name)}</span>
        <${AlarmMark} id=${id} /></span>
      <${StateMark} known=${known} direction=${view.direction} size=${26} />
      <span class="tilehz"><${Value} found=${readingWithoutAge(view, "output_frequency")} big brief
        digits=${isDense ? 1 : undefined} />
        <${Sparkline} id=${id} /></span><${LimitBar} view=${view} />
      <span class="tilerow">${current(view)}<span class="tileset">${t("page.set_short")}
        ${" "}<span class="number">${view.commanded_hz === null ? NO_VALUE : view.commanded_hz.toFixed(1)}</span></span>
        <span class="tileage" title=${slowInterval(view) === null ? undefined
          : t("page.age_of_interval_is")}>${age}</span></span>
      ${view.fault && html`<${Fault} fault=${view.fault} />`}
      ${view.stop_pending && html`<p class="tilefault" title=${t("page.stop_pending")}>${t("page.stop_pending_short")}</p>`}
      ${view.start_inhibited && html`<p class="tilenote">${t("page.start_inhibited")}</p>`}</a>
    ${may("stop") && html`<button type="button" class="tilestop" aria-label=${t("page.stop_named", { name })}
      title=${t("page.stop_named", { name })} onKeyDown=${ignoreRepeat} onClick=${() => stop("drive", id)}>
      <${Icon} name="stop" /><span class="stopword" aria-hidden="true">${t("page.how_stop")}</span></button>`}
  </article>`;
}
