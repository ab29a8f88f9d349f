// Audit trail: user, action, time and outcome of each record; and verification of the chain.
import { html, useMemo, useState } from "../lib.js";
import { hasKey, t } from "../i18n.js";
import { api } from "../api.js";
import { moment } from "../format.js";
import { may } from "../session.js";
import { styled } from "../style.js";
import { Button, ErrorNote, Field, Notice, useRequest } from "../ui.js";
import { PagedEnd, usePaged } from "../parts/paged.js";
import { TimeRange, timeRangeQuery } from "../parts/time-range.js";
import { driveTitle } from "../parts/titles.js";

await styled("pages");

export function Page() {
  if (!may("audit")) return html`<h1>${t("page.nav_audit")}</h1><${Notice}
    kind="warning">${t("page.no_right")}<//>`;
  return html`<h1>${t("page.nav_audit")}</h1><${Verify} /><${Trail} />`;
}

function Verify() {
  const [run, busy, error, result] = useRequest();
  return html`<section class="panel stack"><p>${t("page.audit_how")}</p>
    <div class="row"><${Button} busy=${busy} onClick=${() => run(() => api.get("/audit/verify", {},
      { timeout_ms: 120_000 }))} data-audit="verify">
      ${t("page.verify")}<//></div>
    <${ErrorNote} error=${error} />
    ${result && (result.ok ? html`<${Notice} kind="good" live>${t("page.audit_whole", { n: result.entries })}<//>`
      : html`<${Notice} kind="bad" live title=${t("page.audit_chain_broken", { n: result.problems.length })}>
        <ol>${result.problems.map((problem, n) => html`<li key=${n}>${problemText(problem)}</li>`)}</ol><//>`)}</section>`;
}

const problemText = (problem) => (problem.text ? t("page.both", { text: problem.text }) : JSON.stringify(problem));

function Trail() {
  const [period, setPeriod] = useState({ span: "week" });
  const [search, setSearch] = useState("");
  const query = useMemo(() => timeRangeQuery(period), [period]);
  const list = usePaged("/audit", query);
  const shown = list.items.filter((entry) => matches(entry, search.trim().toLowerCase()));
  return html`<section class="stack"><${TimeRange} value=${period} onChange=${setPeriod}>
      <${Field} label=${t("page.search_loaded")}><input type="search" value=${search}
        onInput=${(event) => setSearch(event.target.value)} /><//><//>
    <ol class="audit">${shown.map((entry) => html`<${Entry} key=${entry.n} entry=${entry} />`)}</ol>
    <${PagedEnd} list=${list} /></section>`;
}

/** Row text in the reader's language, for the search. */
const matches = (entry, text) => !text || [
  [moment(entry.time_ms), userOf(entry), actionText(entry), targetOf(entry), outcomeOf(entry) ?? ""].join(" "),
  JSON.stringify(entry),
].some((words) => words.toLowerCase().includes(text));

const userOf = (entry) => entry.who?.name ?? entry.who ?? "";

/** Subjects of a record other than its user. */
const targetOf = (entry) => (entry.target && entry.target !== userOf(entry) ? driveTitle(entry.target) : "");

/** Text of an operation such as "drive.run"; its name where the catalogue has none. */
function actionText(entry) {
  const key = `page.did_${entry.what.replaceAll(/[.-]/g, "_")}`;
  return hasKey(key) ? t(key) : entry.what;
}

function Entry({ entry }) {
  return html`<li class="entry"><time>${moment(entry.time_ms)}</time><span class="user">${userOf(entry)}</span>
    <span class="what"><strong>${actionText(entry)}</strong> ${targetOf(entry)}</span>
    <${OutcomeCell} entry=${entry} />
    <details class="whole"><summary>${t("page.entry_n", { n: entry.n })}</summary><dl class="facts">
      <dt>${t("page.utc")}</dt><dd>${new Date(entry.time_ms).toISOString()}</dd>
      <dt>${t("page.operation")}</dt><dd><code>${entry.what}</code></dd>
      ${entry.who?.address && html`<dt>${t("page.address_from")}</dt><dd>${entry.who.address}</dd>`}
      ${entry.of != null && html`<dt>${t("page.answers_entry")}</dt><dd>${entry.of}</dd>`}
      <dt>${t("page.params")}</dt><dd><code>${JSON.stringify(entry.params)}</code></dd>
      ${entry.frames?.length > 0 && html`<dt>${t("page.frames_title")}</dt><dd><ol
        class="plain">${entry.frames.map((frame, n) => html`<li key=${n}>
        <code>${frame.sent ?? ""} → ${frame.received || frame.error || "–"}</code></li>`)}</ol></dd>`}
      <dt>${t("page.hash")}</dt><dd><code>${entry.hash}</code></dd></dl></details></li>`;
}

const OUTCOME_KEYS = new Set(["requested", "confirmed", "acknowledged", "refused", "failed", "unknown", "done"]);
const SUCCESS_OUTCOMES = new Set(["requested", "confirmed", "acknowledged", "done"]);

/** Text of an outcome; of an error its text, where the record has the parameters that it needs. */
function outcomeOf({ outcome, params }) {
  if (outcome === null || outcome === undefined) return null;
  const text = OUTCOME_KEYS.has(outcome) ? t(`page.outcome_${outcome}`) : hasKey(outcome) ? t(outcome, params) : outcome;
  return /\{\w+\}/.test(text) ? t("page.outcome_error", { code: outcome }) : text;
}

function OutcomeCell({ entry }) {
  const word = outcomeOf(entry);
  if (word === null) return html`<span></span>`;
  return html`<span class=${`ended ${SUCCESS_OUTCOMES.has(entry.outcome) ? "" : "bad"}`}>${word}</span>`;
}
