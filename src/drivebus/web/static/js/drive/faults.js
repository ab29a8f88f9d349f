// Faults: the one of now, those of the past, and every code that the model knows with cause and remedy.
import { html, useMemo, useState } from "../lib.js";
import { both, t } from "../i18n.js";
import { api } from "../api.js";
import { moment } from "../format.js";
import { Icon } from "../icons.js";
import { ErrorNote, Field, Table, useLoaded } from "../ui.js";

const NONE = "–";
const PAST = 50;

/** Its text, with the keypad's label before it where the text does not say it itself. */
export function faultWords({ label, text }) {
  const words = both(text);
  return words.includes(label) ? html`<b>${words}</b>` : html`<b>${label}</b> · ${words}`;
}

export function FaultNow({ fault }) {
  return html`<section class="faultnow" aria-labelledby="fault-title"><${Icon} name="fault" size=${40} /><div
    class="stack">
    <h2 id="fault-title">${!both(fault.text).includes(fault.label) && `${t("page.fault")} `}${faultWords(fault)}</h2>
    <dl class="facts">${fault.cause && html`<dt>${t("page.cause")}</dt><dd>${both(fault.cause)}</dd>`}
    ${fault.remedy && html`<dt>${t("page.remedy")}</dt><dd>${both(fault.remedy)}</dd>`}
    <dt>${t("page.code")}</dt><dd>${fault.code}</dd></dl></div></section>`;
}

function Past({ id }) {
  const [found, error] = useLoaded(() => api.get("/history/markers", { drive: id, limit: 1000 }), [id]);
  const faults = (found?.items ?? []).filter((one) => one.kind === "fault")
    .sort((a, b) => b.time_ms - a.time_ms).slice(0, PAST);
  return html`<h3>${t("page.past_faults")}</h3><${ErrorNote} error=${error} />
    <${Table} caption=${t("page.past_faults")} rows=${faults} keyOf=${(one) => one.id} empty=${t("page.no_faults")}
      columns=${[
      [t("page.time"), (one) => moment(one.time_ms)],
      [t("page.fault"), (one) => both(one.text), "wide"],
    ]} />`;
}

export function FaultsTab({ view, profile }) {
  return html`<div class="stack"><${Past} id=${view.id} /><h3>${t("page.all_faults")}</h3>
    ${profile.faults.length > 0 ? html`<${Known} view=${view} profile=${profile} />`
      : html`<p>${t("page.no_fault_table")}</p>`}</div>`;
}

function Known({ view, profile }) {
  const [search, setSearch] = useState("");
  const rows = useMemo(() => {
    const word = search.trim().toLowerCase();
    return profile.faults.filter((one) => !word || JSON.stringify(one).toLowerCase().includes(word));
  }, [profile, search]);
  return html`<div class="stack"><${Field} label=${t("page.search")}><input type="search" value=${search}
      onInput=${(event) => setSearch(event.currentTarget.value)} /><//>
    <${Table} caption=${t("page.all_faults")} rows=${rows} keyOf=${(one) => one.code}
      rowClass=${(one) => (view.fault?.code === one.code ? "changed" : undefined)} columns=${[
        [t("page.code"), (one) => one.code, "right"], [t("page.label"), (one) => html`<b>${one.label}</b>`],
        [t("page.fault"), (one) => both(one.text), "wide"], [t("page.cause"), (one) => both(one.cause) || NONE, "wide"],
        [t("page.remedy"), (one) => both(one.remedy) || NONE, "wide"],
      ]} /></div>`;
}
