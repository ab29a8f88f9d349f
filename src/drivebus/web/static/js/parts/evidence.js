// Origin of a fact of a profile: its kind in the reader's language, and the source as the profile cites it, in English.
import { html } from "../lib.js";
import { language, t } from "../i18n.js";

const PAGES = /\bpages? ((?:[A-Z]-)?\d[\d-]*(?:(?:, | and )(?:[A-Z]-)?\d[\d-]*)*)(: )?/g;
/** A word: more than names, registers and units. */
const PROSE = /\b[a-z]{4,}\b/;

/** Source with the numbers of pages in the reader's language. */
function cited(source) {
  if (language.value === "en") return source;
  return source.replace(PAGES, (_, pages, colon) => t("page.evidence_pages", {
    pages: pages.replaceAll(/, | and /g, t("language.between_items")) }) + (colon ? t("page.colon") : ""));
}

export function evidenceText({ kind, source }) {
  const word = t(`page.evidence_${kind}`);
  if (!source) return t("page.evidence", { source: word });
  const found = cited(source);
  return t(PROSE.test(found) ? "page.evidence_excerpt" : "page.evidence_cited", { kind: word, source: found });
}

export const EvidenceNote = ({ evidence }) => html`<p class="soft evidence">${evidenceText(evidence)}</p>`;
