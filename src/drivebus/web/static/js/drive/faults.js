// Faults: past ones, and every fault code of the model with cause and remedy.
import { html, useMemo, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api } from "../api.js";
import { NO_VALUE, moment } from "../format.js";
import { SearchField, hasWords } from "../search.js";
import { ErrorNote, Table, useLoaded } from "../ui.js";

const PAST_FAULT_COUNT = 50;
const LABEL_SEPARATOR = " + "; // between the labels of several faults at once

/** Whether the text of a fault has its label, or that of several faults each of theirs. */
export const namesLabel = ({ label, text }) => label.split(LABEL_SEPARATOR).every((part) => localized(text).includes(part));

/** Text of a fault, preceded by the keypad's label where the text does not contain it. */
export function faultText({ label, text }) {
  const words = localized(text);
  return namesLabel({ label, text }) ? html`<b>${words}</b>` : html`<b>${label}</b> · ${words}`;
}

/** Whether a sentence has a fault's label and its meaning, which the text of some models repeats behind the label. */
export function namesFault(sentence, { label, text }) {
  const labels = label ? label.split(LABEL_SEPARATOR) : [];
  const meaning = labels.length ? localized(text).split(labels.at(-1)).pop().trim() : localized(text);
  return labels.every((part) => sentence.includes(part)) && sentence.includes(meaning);
}

/** Cause and remedy of a fault as `[name, text]`, where the model's manual has them. */
export const adviceOf = (fault) => [[t("page.cause"), fault?.cause], [t("page.remedy"), fault?.remedy]]
  .filter(([, text]) => text).map(([name, text]) => [name, localized(text)]);

function PastFaults({ id }) {
  const [found, error] = useLoaded(() => api.get("/history/events", { drive: id, limit: 1000 }), [id]);
  const faults = (found?.items ?? []).filter((event) => event.kind === "fault")
    .sort((a, b) => b.time_ms - a.time_ms).slice(0, PAST_FAULT_COUNT);
  return html`<h3>${t("page.past_faults")}</h3><${ErrorNote} error=${error} />
    <${Table} caption=${t("page.past_faults")} rows=${faults} keyOf=${(event) => event.id} empty=${t("page.no_faults")}
      columns=${[
      [t("page.time"), (event) => moment(event.time_ms), "time"],
      [t("page.fault"), (event) => localized(event.text), "wide"],
    ]} />`;
}

export function FaultsTab({ view, profile }) {
  return html`<div class="stack"><${PastFaults} id=${view.id} /><h3>${t("page.all_faults")}</h3>
    <${KnownFaults} view=${view} profile=${profile} /></div>`;
}

const searchedText = ({ code, label, text, cause, remedy }) => (
  [code, label, ...[text, cause, remedy].flatMap((localizedText) => Object.values(localizedText ?? {}))].join(" "));

/** Fault codes of a model; that of the present fault of `view`, where one is given, is marked. */
export function KnownFaults({ view, profile }) {
  const [search, setSearch] = useState("");
  const rows = useMemo(() => profile.faults.filter((fault) => hasWords(searchedText(fault), search)), [profile, search]);
  if (profile.faults.length === 0) return html`<p>${t("page.no_fault_table")}</p>`;
  return html`<div class="stack"><${SearchField} value=${search} onChange=${setSearch} />
    <${Table} stacks caption=${t("page.all_faults")} rows=${rows} keyOf=${(fault) => fault.code}
      rowClass=${(fault) => (view?.fault?.code === fault.code ? "changed" : undefined)} columns=${[
        [t("page.code"), (fault) => fault.code, "right"], [t("page.label"), (fault) => html`<b>${fault.label || NO_VALUE}</b>`],
        [t("page.fault"), (fault) => localized(fault.text), "wide"], [t("page.cause"), (fault) => localized(fault.cause) || NO_VALUE, "wide"],
        [t("page.remedy"), (fault) => localized(fault.remedy) || NO_VALUE, "wide"],
      ]} /></div>`;
}
