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
    ${stations.map((station) => html`<${StationNode} key=${station.address} station=${station} />`)}</ol>`;
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
  const slowest = Math.max(0.001, ...stations.map((station) => station.reply_p95_s ?? 0));
  const columns = [
    [t("page.drive"), (station) => html`<a href=${href("drive", station.drive)}>${driveTitle(station.drive)}</a>`, "name"],
    [t("page.address"), (station) => station.address, "right"],
    [t("page.presence"), (station) => html`<${Presence} station=${station} />`],
    [t("page.refresh"), (station) => (station.refresh_s == null ? NO_VALUE : milliseconds(station.refresh_s)), "right"],
    [t("page.reply_time"), (station) => html`<${ReplyBar} station=${station} slowest=${slowest} />`],
    [t("page.bus_load"), (station) => (station.load_percent == null
      ? NO_VALUE : `${station.load_percent.toFixed(1)} %`), "right"],
    [t("page.bus_error_rate"), (station) => percent(station.error_rate), "right"],
    [t("page.bus_errors"), (station) => classes(station.errors, "error") || NO_VALUE],
    [t("page.bus_counters"), (station) => classes(station.counters, "counter") || NO_VALUE],
  ];
  return html`<div class="wide-table"><${Table} stacks caption=${t("page.stations")} columns=${columns} rows=${stations}
    keyOf=${(station) => station.address} /></div>`;
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
