// Live log of a bus's decoded frames: newest last, with pause and filter.
import { html, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../lib.js";
import { localized, language, t } from "../i18n.js";
import { api } from "../api.js";
import { NO_VALUE, clock, duration } from "../format.js";
import { subscribe } from "../live.js";
import { topic } from "../store.js";
import { SearchField } from "../search.js";
import { Button, Choice, Field } from "../ui.js";
import { saveText } from "../save.js";
import { driveTitle } from "../titles.js";

const MAX_ROWS = 300;
const INITIAL_ROWS = 100;
const KIND_ICONS = { sent: "→", reply: "←", invalid: "✕", no_reply: "…" };
/** Filters by kind of frame. */
const KINDS = { all: () => true, sent: (frame) => frame.kind === "sent", received: (frame) => frame.kind !== "sent",
  errors: (frame) => frame.error !== null };

/** The last frames before the log was opened, and live ones since. */
function useFrames(bus) {
  const [before, setBefore] = useState([]);
  useEffect(() => subscribe(`frames/${bus}`), [bus]);
  useEffect(() => {
    api.get(`/buses/${encodeURIComponent(bus)}/frames`, { limit: INITIAL_ROWS }).then((found) => setBefore(found.frames),
      () => {});
  }, [bus]);
  const feed = topic(`frames/${bus}`).value ?? { items: [], missed: 0 };
  const seen = new Map([...before, ...feed.items].map((frame) => [frame.n, frame]));
  const frames = [...seen.values()].sort((one, other) => one.n - other.n);
  return { frames, missed: feed.missed };
}

/** Whether a frame passes the filter. Text is searched in the bytes, with or without blanks, and in their description. */
function matchesFilter(frame, { kind, station, search }) {
  if (!KINDS[kind](frame) || (station !== null && frame.station !== station)) return false;
  const text = search.trim().toLowerCase();
  if (!text) return true;
  const hex = (frame.hex ?? "").toLowerCase();
  const description = `${localized(frame.text)} ${localized(frame.error?.text)}`.toLowerCase();
  return hex.includes(text) || hex.replaceAll(" ", "").includes(text.replaceAll(" ", "")) || description.includes(text);
}

export function FrameLog({ bus, stations }) {
  const { frames, missed } = useFrames(bus);
  const [filter, setFilter] = useState({ kind: "all", station: null, search: "" });
  const [paused, setPaused] = useState(null);
  const base = paused ?? frames;
  const shown = base.filter((frame) => matchesFilter(frame, filter)).slice(-MAX_ROWS);
  const newer = paused ? frames.filter((frame) => frame.n > (paused.at(-1)?.n ?? -1)).length : 0;
  return html`<div class="framelog"><${Filters} filter=${filter} onChange=${setFilter} stations=${stations} />
    <div class="row">
      <${Button} icon=${paused ? "play" : "pause"} aria-pressed=${paused ? "true" : "false"} data-frames="pause"
        onClick=${() => setPaused(paused ? null : frames)}>${t(paused ? "page.go_on" : "page.pause")}<//>
      <${Button} icon="download" disabled=${shown.length === 0} onClick=${() => saveText(`frames-${bus}.txt`,
        asText(shown))}>
        ${t("page.save_shown")}<//>
      <span class="help" role="status">${paused ? t("page.paused", { n: newer }) : ""}
        ${missed > 0 ? ` ${t("page.dropped", { n: missed })}` : ""}</span></div>
    <${Rows} frames=${shown} following=${paused === null} /></div>`;
}

function Filters({ filter, onChange, stations }) {
  const set = (change) => onChange({ ...filter, ...change });
  const kinds = Object.keys(KINDS).map((name) => [name, t(`page.frames_${name}`)]);
  return html`<div class="filters"><${Choice} label=${t("page.frames_which")} value=${filter.kind} options=${kinds}
      onChange=${(kind) => set({ kind })} />
    <${Field} label=${t("page.station_title")}><select value=${filter.station ?? ""} onChange=${(event) =>
      set({ station: event.target.value === "" ? null : Number(event.target.value) })}>
      <option value="">${t("page.every_station")}</option>
      ${stations.map((station) => html`<option key=${station.address}
        value=${station.address}>${station.address} · ${driveTitle(station.drive)}</option>`)}</select><//>
    <${SearchField} value=${filter.search} onChange=${(search) => set({ search })} /></div>`;
}

/** Follow the newest row unless the user has scrolled up. */
function Rows({ frames, following }) {
  const box = useRef(null);
  const atEnd = useRef(true);
  useLayoutEffect(() => {
    if (following && atEnd.current) box.current.scrollTop = box.current.scrollHeight;
  });
  const scrolled = (event) => {
    const { scrollTop, scrollHeight, clientHeight } = event.currentTarget;
    atEnd.current = scrollHeight - scrollTop - clientHeight < 40;
  };
  return html`<div class="frames-box" ref=${box} onScroll=${scrolled} tabindex="0" role="log" aria-live="off"
    aria-label=${t("page.frames_title")}>
    ${frames.length === 0 && html`<p class="help">${t("page.no_frames")}</p>`}
    ${frames.map((frame, at) => html`<${FrameRow} key=${frame.n} frame=${frame} before=${frames[at - 1]} />`)}</div>`;
}

/** Row of a frame, rendered once because a frame does not change. */
function FrameRow({ frame, before }) {
  return useMemo(() => row(frame, before ? (frame.time_s - before.time_s) * 1000 : null), [frame.n, before?.n,
    language.value]);
}

const gapText = (gap_ms) => (gap_ms < 10_000 ? `${gap_ms.toFixed(gap_ms < 100 ? 1 : 0)} ms` : duration(gap_ms / 1000));

/** `gap_ms` is the time since the row above. */
function row(frame, gap_ms) {
  return html`<div class=${`frame ${frame.kind} ${frame.error ? "wrong" : ""}`}>
    <time>${clock(frame.time_ms, true)}</time>
    <span class="gap">${gap_ms !== null && `+${gapText(gap_ms)}`}</span>
    <span class="sign" aria-hidden="true">${KIND_ICONS[frame.kind] ?? "·"}</span><span
      class="sr">${t(`page.frame_kind_${frame.kind}`)}</span>
    <span class="station">${frame.station ?? ""}</span>
    <code class="hex">${frame.hex || NO_VALUE}</code>
    <span class="frame-text">${localized(frame.text)}${frame.error && html` <strong>${localized(frame.error.text)}</strong>`}</span>
      </div>`;
}

/** The frames as text, one a line, for a file. */
function asText(frames) {
  return frames.map((frame) => [
    new Date(frame.time_ms).toISOString(), frame.kind, frame.station ?? "", frame.hex ?? "", localized(frame.text),
      localized(frame.error?.text),
  ].join("\t")).join("\n");
}
