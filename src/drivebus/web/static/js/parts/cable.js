// The stations of a line in the order of the cable: what is bad beyond one of them is bad on the wire there.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { NOTHING } from "../format.js";
import { Icon } from "../icons.js";
import { href } from "../router.js";
import { Table } from "../ui.js";
import { classes, milliseconds, percent } from "./figures.js";
import { driveTitle } from "./titles.js";

const LOOKS = { online: ["check", "calm"], offline: ["silent", "alarm"], never_seen: ["unknown", "doubt"] };
/** From here on a line's errors are worth a look; at ten times as much starts are refused. */
const DOUBTFUL = 0.01;

/** The host, the cable and its stations, as one drawing. */
export function Cable({ stations }) {
  return html`<ol class="cable"><li class="host"><span class="node">▣</span><span
    class="name">${t("plantpage.host")}</span></li>
    ${stations.map((one) => html`<${Node} key=${one.address} station=${one} />`)}</ol>`;
}

function Node({ station }) {
  const [icon, tone] = LOOKS[station.presence] ?? LOOKS.never_seen;
  const doubtful = station.presence === "online" && station.error_rate > DOUBTFUL;
  return html`<li class=${doubtful ? "doubt" : tone}><a href=${href("drive", station.drive)}>
    <span class="node"><${Icon} name=${doubtful ? "warning" : icon} size=${22} /></span>
    <span class="name">${driveTitle(station.drive)}</span>
    <span class="small">${t("plantpage.address_is", { address: station.address })}</span>
    <span class="small">${station.presence === "online" ? t("plantpage.errors_are",
      { share: percent(station.error_rate) })
      : t(`page.presence_${station.presence}`)}</span></a></li>`;
}

/** The same as a table, with all figures. */
export function Stations({ stations }) {
  const slowest = Math.max(0.001, ...stations.map((one) => one.reply_p95_s ?? 0));
  const columns = [
    [t("plantpage.address"), (one) => one.address, "right"],
    [t("plantpage.drive"), (one) => html`<a href=${href("drive", one.drive)}>${driveTitle(one.drive)}</a>`],
    [t("plantpage.presence"), (one) => html`<${Presence} station=${one} />`],
    [t("plantpage.refresh"), (one) => (one.refresh_s == null ? NOTHING : milliseconds(one.refresh_s)), "right"],
    [t("plantpage.reply_time"), (one) => html`<${ReplyBar} station=${one} slowest=${slowest} />`],
    [t("plantpage.bus_load"), (one) => (one.load_percent == null
      ? NOTHING : `${one.load_percent.toFixed(1)} %`), "right"],
    [t("plantpage.bus_error_rate"), (one) => percent(one.error_rate), "right"],
    [t("plantpage.bus_errors"), (one) => classes(one.errors, "error") || NOTHING],
    [t("plantpage.bus_counters"), (one) => classes(one.counters, "counter") || NOTHING],
  ];
  return html`<div class="wide-table"><${Table} caption=${t("plantpage.stations")} columns=${columns} rows=${stations}
    keyOf=${(one) => one.address} /></div>`;
}

function Presence({ station }) {
  const [icon, tone] = LOOKS[station.presence] ?? LOOKS.never_seen;
  const word = station.presence === "online" ? t("plantpage.presence_online") : t(`page.presence_${station.presence}`);
  return html`<span class=${`state ${tone}`}><${Icon} name=${icon} size=${18} />${word}</span>`;
}

/** Half of the replies came within the dark part, 95 of 100 within the whole bar. */
function ReplyBar({ station, slowest }) {
  const { reply_p50_s: half, reply_p95_s: most } = station;
  if (most == null) return NOTHING;
  const wide = (seconds) => ({ width: `${((seconds ?? 0) / slowest) * 100}%` });
  return html`<span class="replybar"><span class="track" aria-hidden="true"><span class="most" style=${wide(most)}>
    </span>
    <span class="half" style=${wide(half)}></span></span>
    <span class="number">${milliseconds(half)} / ${milliseconds(most)}</span></span>`;
}
