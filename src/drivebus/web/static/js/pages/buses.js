// Page of the buses: load, stations in cable order, and the live frame log.
import { html } from "../lib.js";
import { localized, t, titleOf } from "../i18n.js";
import { href } from "../router.js";
import { bus, drive, idsOf, isAbsent } from "../store.js";
import { Icon } from "../icons.js";
import { Loading, Notice } from "../ui.js";
import { NO_VALUE, duration } from "../format.js";
import { isLive } from "../live.js";
import { slowInterval } from "../readings.js";
import { loadStylesheet } from "../stylesheet.js";
import { BusTopology, Stations } from "../buses/bus-topology.js";
import { FrameLog } from "../buses/frame-log.js";
import { classes, isFull, knownBus, milliseconds, percent } from "../buses/bus-figures.js";

await loadStylesheet("pages");

export function Page({ id }) {
  const ids = idsOf("buses").value;
  const chosen = id ?? ids[0];
  return html`<h1>${t("page.nav_buses")}</h1>
    ${ids.length === 0 && html`<p class="help">${t("page.nothing")}</p>`}
    <div class=${`buscards ${id ? "one" : ""}`}>${ids.map((busId) => html`
      <${BusCard} key=${busId} id=${busId} chosen=${busId === chosen} />`)}</div>
    <p class="allbuses"><a href=${href("buses")}>← ${t("page.all_buses")}</a></p>
    ${chosen && html`<${BusDetails} key=${chosen} id=${chosen} />`}`;
}

function BusCard({ id, chosen }) {
  const view = knownBus(bus(id).value);
  if (!view) return null;
  return html`<a class=${`buscard ${view.is_open ? "" : "closed"}`} href=${href("buses", id)} aria-current=${chosen
    ? "true" : undefined}>
    <span class="name">${titleOf(view)}</span>
    <span class=${`state ${view.is_open ? "calm" : "alarm"}`}><${Icon} name=${view.is_open ? "link" : "silent"}
      size=${18} />
      <span>${t(view.is_open ? "page.bus_open" : "page.bus_closed")}</span>
      ${!isLive.value && html`<span class="outdated">${t("page.state_was")}</span>`}</span>
    <${Meter} label=${t("page.load")} value=${view.occupied_percent} full=${isFull(view)} />
    <span class="small">${t("page.bus_serial", { serial: view.serial ?? "", n: view.stations.length })}</span>
    ${isFull(view) && html`<span class="small doubtful"><${Icon} name="warning" size=${16} />${" "}
      ${t("page.bus_full")}</span>`}
    ${view.error_rate > 0.01 && html`<span class="small doubtful"><${Icon} name="warning" size=${16} />${" "}
      ${t("page.errors_are", { share: percent(view.error_rate) })}</span>`}
    ${view.foreign_master && html`<span class="small bad"><${Icon} name="fault"
      size=${16} /> ${t("page.foreign_master")}</span>`}</a>`;
}

/** A share of 100 as a bar with its number. */
function Meter({ label, value, full }) {
  const known = typeof value === "number";
  return html`<span class=${`meter ${full ? "full" : ""}`} role="meter" aria-label=${label} title=${label}
    aria-valuemin="0" aria-valuemax="100" aria-valuenow=${known ? Math.round(value) : 0} aria-valuetext=${known
      ? `${value.toFixed(0)} %` : t("page.no_value")}>
    <span class="bar"><span style=${{ width: `${Math.min(100, known ? value : 0)}%` }}></span></span>
    <span class="number">${known ? `${value.toFixed(0)} %` : NO_VALUE}</span></span>`;
}

function BusDetails({ id }) {
  const view = knownBus(bus(id).value);
  if (!view && !isAbsent(`buses/${id}`)) return html`<${Loading} />`;
  if (!view) return html`<${Notice} kind="warning">${t("page.no_such_bus", { id })}<//>`;
  return html`
    ${view.foreign_master && html`<${Notice} kind="bad"
      title=${t("page.foreign_master")}>${t("page.foreign_master_why")}<//>`}
    ${!view.is_open && html`<${Notice} kind="bad"
      title=${t("page.bus_closed_why", { port: view.port })}>${localized(view.problem)}<//>`}
    ${view.slow_adapter && html`<${Notice} kind="warning">${localized(view.slow_adapter)}<//>`}
    ${isFull(view) ? html`<${Notice} kind="warning" title=${t("page.bus_full_is", { share: percentOf(view.occupied_percent) })}>
      ${t("page.bus_full_why", { serial: view.serial ?? "" })}<//>` : html`<${SlowPolling} view=${view} />`}
    <section class="panel stack"><h2>${titleOf(view)}</h2><${Facts} view=${view} /></section>
    <section class="panel stack"><h2>${t("page.cable")}</h2><p class="help">${t("page.cable_help")}</p>
      <${BusTopology} stations=${view.stations} /><${Stations} stations=${view.stations} /></section>
    <section class="panel stack"><h2>${t("page.frames_title")}</h2><${FrameLog} bus=${id} stations=${view.stations} />
      </section>`;
}

/** Notice where the bus polls its drives less often than they ask for, with what would shorten the interval. */
function SlowPolling({ view }) {
  const drives = view.stations.map((station) => drive(station.drive).value).filter((found) => found && slowInterval(found) !== null);
  if (drives.length === 0) return null;
  const params = {
    n: view.stations.length, slowed: drives.length, serial: view.serial ?? "",
    interval: duration(Math.max(...drives.map(slowInterval))),
    requested: duration(Math.min(...drives.map(({ requested_interval_s }) => requested_interval_s))),
  };
  return html`<${Notice} kind="info" title=${t("page.bus_polls_slowly", params)}>${t("page.bus_polls_slowly_why", params)}<//>`;
}

function Facts({ view }) {
  const facts = [
    ["port", html`<code>${view.port}</code> ${view.serial ?? ""}`],
    ["load", view.load_percent === null ? NO_VALUE : t("page.load_is", { load: percentOf(view.load_percent),
      occupied: percentOf(view.occupied_percent) })],
    ["transactions", view.transactions_per_s === null ? NO_VALUE : t("page.per_second",
      { n: view.transactions_per_s.toFixed(1) })],
    ["reply_times", [view.reply_p50_s, view.reply_p95_s, view.reply_p99_s].map(milliseconds).join(" / ")],
    ["error_rate", percent(view.error_rate)],
    ["errors", classes(view.errors, "error") || t("page.none")],
    ["counters", classes(view.counters, "counter") || t("page.none")],
    ["stop_bound", view.stop_bound_s == null ? NO_VALUE : t("page.stop_bound_is",
      { time: milliseconds(view.stop_bound_s) })],
  ];
  return html`<dl class="facts wide">${facts.map(([name, value]) => html`<div key=${name}>
    <dt>${t(`page.bus_${name}`)}</dt><dd>${value}</dd></div>`)}</dl>`;
}

const percentOf = (value) => `${value.toFixed(1)} %`;
