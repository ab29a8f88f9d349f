// A case: what was known when a drive tripped, frozen: signals of the last minute, parameters, frames.
import { html, useMemo } from "../lib.js";
import { both, language, t } from "../i18n.js";
import { api } from "../api.js";
import { NOTHING, moment, quantity, signalName } from "../format.js";
import { href } from "../router.js";
import { styled } from "../style.js";
import { Button, ErrorNote, Loading, Notice, Table, useLoaded } from "../ui.js";
import { faultWords } from "../drive/faults.js";
import { CaseList } from "../parts/caselist.js";
import { saveText } from "../parts/save.js";
import { driveTitle } from "../parts/titles.js";
import { stamp } from "../trend/labels.js";
import { localeOf } from "../trend/locale.js";
import { HUES } from "../trend/chart.js";
import { Fixed } from "../trend/fixed.js";
import { Trend } from "../trend/trend.js";

await styled("pages");

export function Page({ id }) {
  if (id === null) return html`<h1>${t("plantpage.cases")}</h1><${CaseList} />`;
  return html`<${OneCase} id=${id} />`;
}

function OneCase({ id }) {
  const [found, error] = useLoaded(() => api.get(`/cases/${encodeURIComponent(id)}`), [id]);
  if (!found) return html`<h1>${t("plantpage.case_n", { id })}</h1>${error ? html`<${ErrorNote}
    error=${error} />` : html`<${Loading} />`}`;
  return html`<h1>${driveTitle(found.drive)} · ${moment(found.time_ms)}</h1>
    <div class="row"><a class="button" href=${href("drive", found.drive)}>${t("plantpage.to_drive")}</a>
      <a class="button" href=${href("alarms", null, { tab: "cases" })}>${t("plantpage.cases")}</a>
      <${Button} icon="download" onClick=${() => saveText(`case-${id}.json`, JSON.stringify(found,
        null, 1))}>${t("plantpage.save_case")}<//>
      ${found.capture && html`<${Button} icon="download" title=${t("plantpage.save_capture_help")}
        onClick=${() => saveText(found.capture.name, found.capture.text)}>${t("plantpage.save_capture")}<//>`}</div>
    <${Trip} found=${found} />
    <section class="panel stack"><h2>${t("plantpage.case_signals")}</h2><${Signals} found=${found} /></section>
    <section class="panel stack"><h2>${t("plantpage.case_states")}</h2><${States} found=${found} /></section>
    <section class="panel stack"><h2>${t("plantpage.case_parameters")}</h2><${Parameters}
      parameters=${found.parameters} /></section>
    <section class="panel stack"><h2>${t("plantpage.frames")}</h2><${CaseFrames} frames=${found.frames ?? []} />
      </section>`;
}

/** What raised it, and the fault with its cause and remedy where the drive told one. */
function Trip({ found }) {
  const fault = found.view?.fault;
  const said = fault ? [["cause", fault.cause], ["remedy", fault.remedy]].filter(([, text]) => both(text)) : [];
  return html`<${Notice} kind="bad" title=${both(found.title)}><p>${both(found.text)}</p>
    ${fault && html`<p>${faultWords({ ...fault, label: fault.label ?? String(fault.code) })}</p>`}
    ${said.map(([name, text]) => html`<p key=${name}>
      <b>${t(`plantpage.fault_${name}`)}</b>${t("page.colon")}${both(text)}</p>`)}<//>`;
}

/** How the drive went through its states, in seconds before the trip. */
function States({ found }) {
  const columns = [
    [t("plantpage.before_trip"), (one) => `${one.t.toFixed(2)} s`, "right"],
    [t("plantpage.state"), (one) => t(`drives.state_${one.state}`)],
    [t("plantpage.presence"), (one) => t(one.presence === "online"
      ? "plantpage.presence_online" : `page.presence_${one.presence}`)],
    [t("plantpage.commanded"), (one) => quantity(one.commanded_hz, "Hz"), "right"],
    [t("page.fault"), (one) => (one.fault ? one.fault.label ?? one.fault.code : NOTHING)],
  ];
  return html`<${Table} caption=${t("plantpage.case_states")} columns=${columns} rows=${found.states ?? []}
    keyOf=${(one) => one.t} />`;
}

/** The frozen samples as a trend of their own. */
function Signals({ found }) {
  const source = useMemo(() => new Fixed(found), [found]);
  const lines = source.lines.map(({ tag, signal, unit }, at) => ({
    tag, drive: found.drive, label: signalName(signal), unit, hue: at % HUES,
  }));
  if (lines.length === 0) return html`<p class="help">${t("page.nothing")}</p>`;
  return html`<${Trend} lines=${lines} source=${source} window=${source.window} height=${320} />`;
}

function Parameters({ parameters }) {
  if (!parameters) return html`<p class="help">${t("plantpage.parameters_not_read")}</p>`;
  const rows = Object.entries(parameters ?? {});
  const columns = [
    [t("plantpage.parameter"), ([name]) => html`<code>${name}</code>`],
    [t("plantpage.wire_address"), ([, one]) => html`<code>${one.address_hex ?? ""}</code>`],
    [t("plantpage.value"), ([, one]) => heldOrWhy(one), "right"],
    [t("plantpage.raw"), ([, one]) => one.raw ?? NOTHING, "right"],
  ];
  return html`<${Table} caption=${t("plantpage.case_parameters")} columns=${columns} rows=${rows}
    keyOf=${([name]) => name} />`;
}

/** What it held, or why nobody knows. */
function heldOrWhy({ value, unit, reason }) {
  if (value !== null) return `${value} ${unit ?? ""}`;
  return html`<span class="small">${reason ? t(reason) : t("page.no_value")}</span>`;
}

function CaseFrames({ frames }) {
  const columns = [
    [t("plantpage.time"), (frame) => stamp(frame.time_ms, localeOf(language.value))],
    [t("plantpage.station"), (frame) => frame.station ?? "", "right"],
    [t("plantpage.bytes"), (frame) => html`<code>${frame.kind === "sent" ? "→" : "←"} ${frame.hex ?? ""}</code>`],
    [t("plantpage.meaning"), (frame) => `${both(frame.text)} ${both(frame.error?.text)}`],
  ];
  return html`<div class="case-frames"><${Table} caption=${t("plantpage.frames")} columns=${columns} rows=${frames}
    keyOf=${(frame) => frame.n} /></div>`;
}
