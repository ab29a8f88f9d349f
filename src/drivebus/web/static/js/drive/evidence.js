// Origin of a fact of a profile: its kind and source in the reader's language.
import { html } from "../lib.js";
import { localized, t } from "../i18n.js";

export function evidenceText({ kind, text }) {
  const word = t(`page.evidence_${kind}`);
  const source = localized(text);
  return source ? t("page.evidence_cited", { kind: word, source }) : t("page.evidence", { source: word });
}

export const EvidenceNote = ({ evidence }) => html`<p class="soft evidence">${evidenceText(evidence)}</p>`;
