// Incident: the record of a trip with the signals of the last minute, states, parameters and frames.
import { html, useEffect, useMemo, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api } from "../api.js";
import { NO_VALUE, clock, moment, quantity } from "../format.js";
import { signalName } from "../signal-names.js";
import { isLive } from "../live.js";
import { href } from "../router.js";
import { may } from "../session.js";
import { loadStylesheet } from "../stylesheet.js";
import { Button, ErrorNote, Loading, Notice, Table, useLoaded, useRequest, withWholeNumbers } from "../ui.js";
import { ReasonField, isLongEnough } from "../control/reason-field.js";
import { adviceOf, faultText, namesFault } from "../drive/faults.js";
import { UncertainNote } from "../drive/parameter-text.js";
import { IncidentList } from "../alarms/incident-list.js";
import { saveText } from "../save.js";
import { serviceNow } from "../store.js";
import { driveTitle } from "../titles.js";
import { StaticSource } from "../trend/static-source.js";
import { Trend } from "../trend/trend.js";
import { HUES, firstLines } from "../trend/lines.js";

await loadStylesheet("pages");

const READ_AGAIN_MS = 2000;
/** Time after the trip within which its parameters may still be read from the drive. */
const READING_MS = 120_000;

export function Page({ id }) {
  if (id === null) return html`<h1>${t("page.incidents")}</h1><${IncidentList} />`;
  return html`<${IncidentDetails} id=${id} />`;
}

function IncidentDetails({ id }) {
  const [found, error, reload] = useLoaded(() => api.get(`/incidents/${encodeURIComponent(id)}`), [id]);
  const isReading = found !== null && !found.parameters && serviceNow() - found.time_ms < READING_MS;
  useEffect(() => {
    if (!isReading) return undefined;
    const timer = setTimeout(reload, READ_AGAIN_MS);
    return () => clearTimeout(timer);
  }, [found, error]);
  if (!found) return html`<h1>${t("page.incident_n", { id })}</h1>${error ? html`<${ErrorNote}
    error=${error} />` : html`<${Loading} />`}`;
  return html`<h1>${driveTitle(found.drive)} · <time>${moment(found.time_ms)}</time></h1>
    <div class="row"><a class="button" href=${href("drive", found.drive)}>${t("page.to_drive")}</a>
      <a class="button" href=${href("alarms", null, { tab: "incidents" })}>${t("page.incidents")}</a>
      <${Button} icon="download" onClick=${() => saveText(`incident-${id}.json`, JSON.stringify(found,
        null, 1))}>${t("page.save_incident")}<//>
      ${found.capture && html`<${Button} icon="download" title=${t("page.save_capture_help")}
        onClick=${() => saveText(found.capture.name, found.capture.text)}>${t("page.save_capture")}<//>`}</div>
    ${found.capture_problem && html`<${Notice} kind="warning">${localized(found.capture_problem)}<//>`}
    <${Trip} found=${found} /><${Notes} key=${id} found=${found} />
    <section class="panel stack"><h2>${t("page.incident_signals")}</h2><${Signals} found=${found} /></section>
    <section class="panel stack"><h2>${t("page.incident_states")}</h2><${States} found=${found} /></section>
    <section class="panel stack"><h2>${t("page.incident_parameters")}</h2><${Parameters}
      parameters=${found.parameters} isReading=${isReading} /></section>
    <section class="panel stack"><h2>${t("page.frames_title")}</h2><${IncidentFrames} frames=${found.frames ?? []} />
      </section>`;
}

/** Alarm of the incident, and the drive's fault with cause and remedy. */
function Trip({ found }) {
  const fault = found.view?.fault;
  const [title, text] = [localized(found.title), localized(found.text)];
  const hasTitle = text.toLowerCase().includes(title.toLowerCase()); // such as the name of an interlock
  return html`<${Notice} kind="bad" title=${hasTitle ? text : title}>${!hasTitle && html`<p>${text}</p>`}
    ${fault && !namesFault(text, fault) && html`<p>${faultText({ ...fault, label: fault.label ?? String(fault.code) })}</p>`}
    ${adviceOf(fault).map(([name, text]) => html`<p key=${name}><b>${name}</b>${t("page.colon")}${text}</p>`)}<//>`;
}

/** Notes of people, oldest first, and the field for another one. */
function Notes({ found }) {
  const [notes, setNotes] = useState(found.notes ?? []);
  const [text, setText] = useState("");
  const [execute, busy, error] = useRequest();
  const send = async (event) => {
    event.preventDefault();
    const answer = await execute(() => api.post(`/incidents/${encodeURIComponent(found.id)}/notes`, { note: text.trim() }));
    if (answer) { setNotes(answer.notes); setText(""); }
  };
  return html`<section class="panel stack notes"><h2>${t("page.incident_notes")}</h2>
    ${notes.length === 0 && html`<p class="help">${t("page.no_notes")}</p>`}
    <ol class="plain">${notes.map((note, n) => html`<li key=${n}><b>${note.by}</b> <time>${moment(note.time_ms)}</time>
      <p>${note.text}</p></li>`)}</ol>
    ${may("operate") && html`<form class="row" onSubmit=${send}>
      <${ReasonField} label=${t("page.note_new")} help=${t("page.note_help")} value=${text} onChange=${setText} />
      <button class="button main" type="submit" disabled=${busy || !isLive.value || !isLongEnough(text)}>${t("page.note_add")}</button></form>`}
    <${ErrorNote} error=${error} /></section>`;
}

/** States of the drive, in seconds before the trip. */
function States({ found }) {
  const columns = [
    [t("page.before_trip"), (state) => `${state.t.toFixed(2)} s`, "right"],
    [t("page.state"), (state) => t(`drives.state_${state.state}`)],
    [t("page.fault"), (state) => (state.fault ? state.fault.label || localized(state.fault.text) : NO_VALUE)],
    [t("page.commanded_column"), (state) => quantity(state.commanded_hz, "Hz"), "right"],
    [t("page.presence"), (state) => t(`page.presence_${state.presence}`)],
  ];
  return html`<${Table} stacks caption=${t("page.incident_states")} columns=${columns} rows=${found.states ?? []}
    keyOf=${(state) => state.t} />`;
}

/** Samples of the incident as a trend. */
function Signals({ found }) {
  const source = useMemo(() => new StaticSource(found), [found.id]); // what was recorded stays
  const lines = source.lines.map(({ tag, signal, unit }, at) => ({
    tag, drive: found.drive, label: signalName(signal), unit, hue: at % HUES,
  }));
  if (lines.length === 0) return html`<p class="help">${t("page.nothing")}</p>`;
  const first = firstLines(lines);
  const hidden = lines.filter((line) => !first.includes(line)).map((line) => line.tag);
  return html`<${Trend} lines=${lines} source=${source} window=${source.window} hidden=${hidden} height=${320} />`;
}

function Parameters({ parameters, isReading }) {
  if (!parameters) return html`<p class="help">${t(isReading ? "page.parameters_being_read"
    : "page.parameters_not_read")}</p>`;
  const rows = Object.entries(parameters);
  const columns = [
    [t("page.notation"), ([name]) => html`<code>${name}</code>`],
    [t("page.parameter"), ([, parameter]) => withWholeNumbers(localized(parameter.text)), "wide"],
    [t("page.wire_address"), ([, parameter]) => html`<code>${parameter.address_hex ?? ""}</code>`],
    [t("page.value"), ([, parameter]) => valueOrReason(parameter), "right"],
    [t("page.raw"), ([, parameter]) => parameter.raw ?? NO_VALUE, "right"],
  ];
  return html`<${Table} stacks caption=${t("page.incident_parameters")} columns=${columns} rows=${rows}
    keyOf=${([name]) => name} />`;
}

/** Value of a parameter, or the reason why it could not be read. */
function valueOrReason({ value, unit, quality, reason }) {
  if (value !== null) return html`${value} ${unit ?? ""}<${UncertainNote} quality=${quality} reason=${reason} />`;
  return html`<span class="small">${reason ? t(reason) : t("page.no_value")}</span>`;
}

function IncidentFrames({ frames }) {
  const columns = [
    [t("page.time"), (frame) => clock(frame.time_ms, true)],
    [t("page.station_title"), (frame) => frame.station ?? "", "right"],
    [t("page.bytes"), (frame) => html`<code>${frame.kind === "sent" ? "→" : "←"} ${frame.hex ?? ""}</code>`],
    [t("page.meaning"), (frame) => `${localized(frame.text)} ${localized(frame.error?.text)}`],
  ];
  return html`<div class="incident-frames"><${Table} stacks caption=${t("page.frames_title")} columns=${columns} rows=${frames}
    keyOf=${(frame) => frame.n} /></div>`;
}
