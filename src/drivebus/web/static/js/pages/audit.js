// The audit trail: who did what, when, and what came of it; and whether the chain is whole.
import { html, useMemo, useState } from "../lib.js";
import { known, t } from "../i18n.js";
import { api } from "../api.js";
import { moment } from "../format.js";
import { may } from "../session.js";
import { styled } from "../style.js";
import { Button, ErrorNote, Field, Notice, useAsk } from "../ui.js";
import { PagedEnd, usePaged } from "../parts/paged.js";
import { Period, asQuery } from "../parts/period.js";
import { driveTitle } from "../parts/titles.js";

await styled("pages");

export function Page() {
  if (!may("audit")) return html`<h1>${t("page.way_audit")}</h1><${Notice}
    kind="warning">${t("plantpage.no_right")}<//>`;
  return html`<h1>${t("page.way_audit")}</h1><${Verify} /><${Trail} />`;
}

function Verify() {
  const [run, busy, error, result] = useAsk();
  return html`<section class="panel stack"><p>${t("plantpage.audit_how")}</p>
    <div class="row"><${Button} busy=${busy} onClick=${() => run(() => api.get("/audit/verify", {},
      { patience_ms: 120_000 }))} data-audit="verify">
      ${t("plantpage.verify")}<//></div>
    <${ErrorNote} error=${error} />
    ${result && (result.ok ? html`<${Notice} kind="good" live>${t("plantpage.audit_whole", { n: result.entries })}<//>`
      : html`<${Notice} kind="bad" live title=${t("plantpage.audit_broken", { n: result.problems.length })}>
        <ol>${result.problems.map((problem, n) => html`<li key=${n}>${sentence(problem)}</li>`)}</ol><//>`)}</section>`;
}

const sentence = (problem) => (problem.text ? t("plantpage.both", { text: problem.text }) : JSON.stringify(problem));

function Trail() {
  const [period, setPeriod] = useState({ span: "week" });
  const [sought, setSought] = useState("");
  const query = useMemo(() => asQuery(period), [period]);
  const list = usePaged("/audit", query);
  const shown = list.items.filter((entry) => matches(entry, sought.trim().toLowerCase()));
  return html`<section class="stack"><${Period} value=${period} onChange=${setPeriod}>
      <${Field} label=${t("plantpage.sought_loaded")}><input type="search" value=${sought}
        onInput=${(event) => setSought(event.target.value)} /><//><//>
    <ol class="audit">${shown.map((entry) => html`<${Entry} key=${entry.n} entry=${entry} />`)}</ol>
    <${PagedEnd} list=${list} /></section>`;
}

/** Whatever the row says in the reader's language, and all that the record holds. */
const matches = (entry, text) => !text || [
  [moment(entry.time_ms), whoOf(entry), wordOf(entry), targetOf(entry), endOf(entry) ?? ""].join(" "),
  JSON.stringify(entry),
].some((words) => words.toLowerCase().includes(text));

const whoOf = (entry) => entry.who?.name ?? entry.who ?? "";

/** What it was done to, but for whoever did it. */
const targetOf = (entry) => (entry.target && entry.target !== whoOf(entry) ? driveTitle(entry.target) : "");

/** "drive.run" as a person says it; the operation's own name where the catalogue has none. */
function wordOf(entry) {
  const key = `plantpage.did_${entry.what.replaceAll(/[.-]/g, "_")}`;
  return known(key) ? t(key) : entry.what;
}

function Entry({ entry }) {
  return html`<li class="entry"><time>${moment(entry.time_ms)}</time><span class="who">${whoOf(entry)}</span>
    <span class="what"><strong>${wordOf(entry)}</strong> ${targetOf(entry)}</span>
    <${Ended} entry=${entry} />
    <details class="whole"><summary>${t("plantpage.entry_n", { n: entry.n })}</summary><dl class="facts">
      <dt>${t("plantpage.utc")}</dt><dd>${new Date(entry.time_ms).toISOString()}</dd>
      <dt>${t("plantpage.operation")}</dt><dd><code>${entry.what}</code></dd>
      ${entry.who?.address && html`<dt>${t("plantpage.address_from")}</dt><dd>${entry.who.address}</dd>`}
      ${entry.of != null && html`<dt>${t("plantpage.answers_entry")}</dt><dd>${entry.of}</dd>`}
      <dt>${t("plantpage.params")}</dt><dd><code>${JSON.stringify(entry.params)}</code></dd>
      ${entry.frames?.length > 0 && html`<dt>${t("plantpage.frames")}</dt><dd><ol
        class="plain">${entry.frames.map((frame, n) => html`<li key=${n}>
        <code>${frame.sent ?? ""} → ${frame.received || frame.error || "–"}</code></li>`)}</ol></dd>`}
      <dt>${t("plantpage.hash")}</dt><dd><code>${entry.hash}</code></dd></dl></details></li>`;
}

const WORDS = new Set(["asked", "confirmed", "acknowledged", "refused", "failed", "unknown", "done"]);
const GOOD = new Set(["asked", "confirmed", "acknowledged", "done"]);

/** The word of an outcome; of an error its sentence, where the record has the numbers that it needs. */
function endOf({ outcome, params }) {
  if (outcome === null || outcome === undefined) return null;
  const told = WORDS.has(outcome) ? t(`plantpage.outcome_${outcome}`) : known(outcome) ? t(outcome, params) : outcome;
  return /\{\w+\}/.test(told) ? t("plantpage.outcome_error", { code: outcome }) : told;
}

function Ended({ entry }) {
  const word = endOf(entry);
  if (word === null) return html`<span></span>`;
  return html`<span class=${`ended ${GOOD.has(entry.outcome) ? "" : "bad"}`}>${word}</span>`;
}
