// Audit trail: user, action, time and outcome of each record; and verification of the chain.
import { html, useMemo, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api } from "../api.js";
import { NO_VALUE, moment } from "../format.js";
import { idle, may } from "../session.js";
import { loadStylesheet } from "../stylesheet.js";
import { SearchField } from "../search.js";
import { Button, ErrorNote, Notice, useRequest } from "../ui.js";
import { PagedEnd, usePaged } from "../paged.js";
import { TimeRange, timeRangeQuery } from "../time-range.js";

await loadStylesheet("pages");

export function Page() {
  if (!may("audit")) return html`<h1>${t("page.nav_audit")}</h1><${Notice} kind="warning">${t(idle.value ? "page.idle" : "page.no_right")}<//>`;
  return html`<h1>${t("page.nav_audit")}</h1><${Verify} /><${Trail} />`;
}

function Verify() {
  const [execute, busy, error, result] = useRequest();
  return html`<section class="panel stack"><p>${t("page.audit_how")}</p>
    <div class="row"><${Button} busy=${busy} onClick=${() => execute(() => api.get("/audit/verify", {},
      { timeout_ms: 120_000 }))} data-audit="verify">
      ${t("page.verify")}<//></div>
    <${ErrorNote} error=${error} />
    ${result && (result.ok ? html`<${Notice} kind="good" live>${t("page.audit_whole", { n: result.entries })}<//>`
      : html`<${Notice} kind="bad" live title=${t("page.audit_chain_broken", { n: result.problems.length })}>
        <ol>${result.problems.map((problem, n) => html`<li key=${n}>${problemText(problem)}</li>`)}</ol><//>`)}</section>`;
}

const problemText = (problem) => (problem.text ? localized(problem.text) : JSON.stringify(problem));

function Trail() {
  const [period, setPeriod] = useState({ span: "week" });
  const [search, setSearch] = useState("");
  const query = useMemo(() => timeRangeQuery(period), [period]);
  const list = usePaged("/audit", query);
  const actions = useMemo(() => joinRecords(list.items), [list.items]);
  const shown = actions.filter((action) => matches(action, search.trim().toLowerCase()));
  return html`<section class="stack"><${TimeRange} value=${period} onChange=${setPeriod}>
      <${SearchField} label=${t("page.search_loaded")} value=${search} onChange=${setSearch} /><//>
    <ol class="audit">${shown.map((action) => html`<${ActionRow} key=${action.entry.n} action=${action} />`)}</ol>
    ${shown.length === 0 && actions.length > 0 && html`<p class="nothing" role="status">${t("page.search_none")}</p>`}
    <${PagedEnd} list=${list} /></section>`;
}

/** Row text in the reader's language and the records of an action, for the search. */
const matches = ({ entry, request }, text) => !text || [
  [moment(entry.time_ms), userOf(entry), localized(entry.text), localized(entry.outcome_text)].join(" "),
  JSON.stringify([entry, request]),
].some((words) => words.toLowerCase().includes(text));

const userOf = (entry) => entry.who?.name ?? entry.who ?? "";

/** An action is one row: the record of its result with that of its request, the newest first. A request without a result
 * among the loaded records is a row of its own. */
export function joinRecords(entries) {
  const results = new Map();
  const actions = [];
  for (const entry of entries) {
    const own = entry.outcome === "requested" ? results.get(entry.n) ?? results.get(requestKey(entry)) : undefined;
    if (own) {
      own.request = entry;
      results.delete(entry.n);
      results.delete(requestKey(entry));
      continue;
    }
    const action = { entry, request: null };
    actions.push(action);
    // Changes of users name no request: theirs is the next older one of the same user, action and target.
    if (entry.outcome !== "requested") results.set(entry.of ?? requestKey(entry), action);
  }
  return actions;
}

const requestKey = (entry) => JSON.stringify([entry.what, entry.target, userOf(entry), entry.who?.session]);

function ActionRow({ action: { entry, request } }) {
  return html`<li class="entry"><time>${moment(entry.time_ms)}</time><span class="user">${userOf(entry)}</span>
    <span class="what">${localized(entry.text)}</span>
    <span class=${`ended ${isSuccess(entry) ? "" : "bad"}`}>${localized(entry.outcome_text)}</span>
    <details class="whole"><summary>${request ? t("page.entries_n", { from: request.n, to: entry.n })
      : t("page.entry_n", { n: entry.n })}</summary>
      ${request && html`<${Record} entry=${request} />`}<${Record} entry=${entry} /></details></li>`;
}

function Record({ entry }) {
  return html`<dl class="facts">
      <dt>${t("page.entry_n", { n: entry.n })}</dt><dd>${localized(entry.outcome_text)}</dd>
      <dt>${t("page.utc")}</dt><dd>${new Date(entry.time_ms).toISOString()}</dd>
      <dt>${t("page.operation")}</dt><dd><code>${entry.what}</code> ${entry.target}</dd>
      ${entry.who?.address && html`<dt>${t("page.address_from")}</dt><dd>${entry.who.address}</dd>`}
      ${entry.of != null && html`<dt>${t("page.answers_entry")}</dt><dd>${entry.of}</dd>`}
      <dt>${t("page.params")}</dt><dd><code>${JSON.stringify(entry.params)}</code></dd>
      ${entry.frames?.length > 0 && html`<dt>${t("page.frames_title")}</dt><dd><ol
        class="plain">${entry.frames.map((frame, n) => html`<li key=${n}>
        <code>${frame.sent ?? ""} → ${frame.received || frame.error || NO_VALUE}</code></li>`)}</ol></dd>`}
      <dt>${t("page.hash")}</dt><dd><code>${entry.hash}</code></dd></dl>`;
}

const SUCCESS_OUTCOMES = new Set(["requested", "confirmed", "acknowledged", "done", "unchanged", "trips", "stops"]);
const isSuccess = ({ outcome }) => !outcome || outcome.split(", ").every((part) => SUCCESS_OUTCOMES.has(part));
