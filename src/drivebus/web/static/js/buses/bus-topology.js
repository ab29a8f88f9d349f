// Stations of a bus in cable order: errors that begin at one station point at the cable before it.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { isLive } from "../live.js";
import { NO_VALUE } from "../format.js";
import { Icon } from "../icons.js";
import { href } from "../router.js";
import { Table } from "../ui.js";
import { classes, milliseconds, percent } from "./bus-figures.js";
import { driveTitle } from "../titles.js";
import { drive } from "../store.js";

const PRESENCE_APPEARANCES = { online: ["check", "calm"], offline: ["silent", "alarm"], never_seen: ["unknown", "doubt"],
  unusable: ["warning", "alarm"] };
/** Error rate that is marked; starts are refused at ten times as much. */
const ERROR_RATE_WARNING = 0.01;

/** Presence of a station, or "unusable" where bytes come in place of its reply. */
const presenceOf = ({ drive: id, presence }) =>
  (presence !== "online" && drive(id).value?.unusable_reply ? "unusable" : presence);

/** [icon, tone] of the presence, which may be over without a live connection. */
const appearanceOf = (station) => (isLive.value && PRESENCE_APPEARANCES[presenceOf(station)]) || PRESENCE_APPEARANCES.never_seen;

/** The host, the cable and its stations, as one drawing. */
export function BusTopology({ stations }) {
  return html`<ol class="cable"><li class="host"><span class="node">▣</span><span
    class="name">${t("page.host")}</span></li>
    ${stations.map((one) => html`<${StationNode} key=${one.address} station=${one} />`)}</ol>`;
}

function StationNode({ station }) {
  const [icon, tone] = appearanceOf(station);
  const doubtful = isLive.value && station.presence === "online" && station.error_rate > ERROR_RATE_WARNING;
  return html`<li class=${doubtful ? "doubt" : tone}><a href=${href("drive", station.drive)}>
    <span class="node"><${Icon} name=${doubtful ? "warning" : icon} size=${22} /></span>
    <span class="name">${driveTitle(station.drive)}</span>
    <span class="small">${t("page.address_is", { address: station.address })}</span>
    <span class="small">${station.presence === "online" ? t("page.errors_are",
      { share: percent(station.error_rate) })
      : t(`page.presence_${presenceOf(station)}`)}</span></a></li>`;
}

/** Stations of a bus as a table, with all figures. */
export function Stations({ stations }) {
  const slowest = Math.max(0.001, ...stations.map((one) => one.reply_p95_s ?? 0));
  const columns = [
    [t("page.drive"), (one) => html`<a href=${href("drive", one.drive)}>${driveTitle(one.drive)}</a>`, "name"],
    [t("page.address"), (one) => one.address, "right"],
    [t("page.presence"), (one) => html`<${Presence} station=${one} />`],
    [t("page.refresh"), (one) => (one.refresh_s == null ? NO_VALUE : milliseconds(one.refresh_s)), "right"],
    [t("page.reply_time"), (one) => html`<${ReplyBar} station=${one} slowest=${slowest} />`],
    [t("page.bus_load"), (one) => (one.load_percent == null
      ? NO_VALUE : `${one.load_percent.toFixed(1)} %`), "right"],
    [t("page.bus_error_rate"), (one) => percent(one.error_rate), "right"],
    [t("page.bus_errors"), (one) => classes(one.errors, "error") || NO_VALUE],
    [t("page.bus_counters"), (one) => classes(one.counters, "counter") || NO_VALUE],
  ];
  return html`<div class="wide-table"><${Table} stacks caption=${t("page.stations")} columns=${columns} rows=${stations}
    keyOf=${(one) => one.address} /></div>`;
}

function Presence({ station }) {
  const [icon, tone] = appearanceOf(station);
  const word = t(`page.presence_${presenceOf(station)}`);
  return html`<span class=${`state ${tone}`}><${Icon} name=${icon} size=${18} />${word}
    ${!isLive.value && html`<span class="outdated">${t("page.state_was")}</span>`}</span>`;
}

/** Half of the replies came within the dark part, 95 of 100 within the whole bar. */
function ReplyBar({ station, slowest }) {
  const { reply_p50_s: half, reply_p95_s: most } = station;
  if (most == null) return NO_VALUE;
  const wide = (seconds) => ({ width: `${((seconds ?? 0) / slowest) * 100}%` });
  return html`<span class="replybar"><span class="track" aria-hidden="true"><span class="most" style=${wide(most)}>
    </span>
    <span class="half" style=${wide(half)}></span></span>
    <span class="number">${milliseconds(half)} / ${milliseconds(most)}</span></span>`;
}
