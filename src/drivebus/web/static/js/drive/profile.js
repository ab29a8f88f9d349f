// Profile of the model: capabilities, caveats, keypad settings, wiring, open questions.
import { html } from "../lib.js";
import { localized, t } from "../i18n.js";
import { Notice, Table } from "../ui.js";

const CAPABILITIES = [
  "run", "reverse", "stop", "coast", "quick_stop", "jog", "set_frequency", "reset_fault", "read", "write", "write_ram",
  "save", "identify", "broadcast_stop", "status",
];

function Facts({ profile }) {
  const { serial, limits } = profile;
  const can = CAPABILITIES.filter((name) => profile.capabilities.includes(name));
  const not = CAPABILITIES.filter((name) => !profile.capabilities.includes(name));
  const listed = (names) => names.map((name) => t(`page.can_${name}`)).join(t("page.comma")) || "–";
  return html`<dl class="facts"><dt>${t("page.model")}</dt><dd>${localized(profile.title)} (<code>${profile.model}
    </code>)</dd>
    <dt>${t("page.maker")}</dt><dd>${localized(profile.maker)}</dd>
    <dt>${t("page.grade")}</dt><dd>${t(`page.grade_${profile.grade}`)}: ${t(`page.grade_${profile.grade}_means`)}</dd>
    <dt>${t("page.encodings")}</dt><dd>${profile.encodings.join(t("page.comma"))}</dd>
    <dt>${t("page.serial_default")}</dt><dd>${serial.baud} ${serial.format}</dd>
    <dt>${t("page.limits_model")}</dt><dd>${limits.minimum_hz} … ${limits.maximum_hz} Hz</dd>
    <dt>${t("page.can")}</dt><dd>${listed(can)}</dd><dt>${t("page.can_not")}</dt><dd>${listed(not)}</dd></dl>`;
}

export function ProfileTab({ profile }) {
  return html`<div class="stack"><${Facts} profile=${profile} />
    ${profile.caveats.length > 0 && html`<h3>${t("page.caveats")}</h3>${profile.caveats.map((one) => html`
      <${Notice} key=${one.id} kind="warning" title=${one.id}><p>${localized(one.text)}</p>
      <p class="soft">${t("page.evidence", {
        source: one.evidence.source || t(`page.evidence_${one.evidence.kind}`) })}</p><//>`)}`}
    <h3>${t("page.keypad")}</h3><ol>${profile.keypad.map((text, n) => html`<li key=${n}>${localized(text)}</li>`)}</ol>
    <h3>${t("page.wiring")}</h3><p>${localized(profile.wiring)}</p>
    ${profile.open_questions.length > 0 && html`<h3>${t("page.open_questions")}</h3>
      ${profile.open_questions.map((one) => html`
      <${Notice} key=${one.name} title=${localized(one.text)}><p>${localized(one.reason)}</p><p>${localized(one.procedure)}</p>
        <//>`)}`}
    <h3>${t("page.signals")}</h3><${Table} caption=${t("page.signals")} rows=${profile.signals}
      keyOf=${(one) => one.name} columns=${[
      [t("page.signal"), (one) => localized(one.text) || one.name, "wide"], [t("page.notation"), (one) => html`<code>
        ${one.notation}</code>`],
      [t("page.wire_address"), (one) => html`<code>${one.address_hex}</code>`], [t("page.unit"), (one) => one.unit],
      [t("page.period"), (one) => `${one.period_s} s`, "right"],
    ]} /></div>`;
}
