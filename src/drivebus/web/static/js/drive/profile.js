// Profile of the model: capabilities, caveats, keypad settings, wiring, open questions.
import { html, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api, drivePath } from "../api.js";
import { NO_VALUE } from "../format.js";
import { isLive } from "../live.js";
import { reading } from "../readings.js";
import { href } from "../router.js";
import { may } from "../session.js";
import { Button, ErrorNote, Notice, Table, useRequest } from "../ui.js";
import { EvidenceNote } from "./evidence.js";

const CAPABILITIES = [
  "run", "reverse", "stop", "coast", "quick_stop", "pause", "hold_ramp", "jog", "set_frequency", "reset_fault", "read", "write", "write_ram",
  "save", "identify", "broadcast_stop", "status",
];

function Facts({ profile }) {
  const { serial, limits } = profile;
  const can = CAPABILITIES.filter((name) => profile.capabilities.includes(name));
  const not = CAPABILITIES.filter((name) => !profile.capabilities.includes(name));
  const listed = (names) => names.map((name) => t(`page.can_${name}`)).join(t("language.between_items")) || NO_VALUE;
  return html`<dl class="facts"><dt>${t("page.model")}</dt><dd>${localized(profile.title)} (<code>${profile.model}
    </code>)</dd>
    <dt>${t("page.maker")}</dt><dd>${localized(profile.maker)}</dd>
    <dt>${t("page.grade")}</dt><dd>${t(`page.grade_${profile.grade}`)}${t("page.colon")}${t(`page.grade_${profile.grade}_means`)}</dd>
    <dt>${t("page.encodings")}</dt><dd>${profile.encodings.join(t("language.between_items"))}</dd>
    <dt>${t("page.serial_default")}</dt><dd>${serial.baud} ${serial.format}</dd>
    <dt>${t("page.limits_model")}</dt><dd>${limits.minimum_hz} … ${limits.maximum_hz} Hz</dd>
    <dt>${t("page.can")}</dt><dd>${listed(can)}</dd><dt>${t("page.can_not")}</dt><dd>${listed(not)}</dd></dl>`;
}

const yesOrNo = (value) => (value === null ? NO_VALUE : t(value ? "page.yes" : "page.no"));

/** Identity that the drive itself reports: read on demand, because reading takes bus time. */
function Identity({ id }) {
  const [found, setFound] = useState(null);
  const [execute, busy, error] = useRequest();
  const read = () => execute(async () => setFound(await api.post(drivePath(id, "/identity/read"))));
  const facts = found && [
    ["page.identity_rating", [found.voltage_class_v && `${found.voltage_class_v} V`,
      found.power_kw !== null && `${found.power_kw} kW`].filter(Boolean).join(t("language.between_items"))],
    ...Object.entries(found.digits).map(([part, digits]) => [`page.identity_${part}`, html`<code>${digits}</code>`]),
    ["page.identity_host_controls", yesOrNo(found.host_controls)],
    ["page.identity_host_frequency", yesOrNo(found.host_sets_frequency)],
  ];
  return html`<h3>${t("page.identity")}</h3>${facts && html`<dl class="facts" data-text="identity">
    ${facts.map(([key, value]) => html`<dt>${t(key)}</dt><dd>${value || NO_VALUE}</dd>`)}</dl>`}<${ErrorNote} error=${error} />
    <div class="row"><${Button} busy=${busy} disabled=${!isLive.value} onClick=${read} data-do="read-identity">
      ${t("page.identity_read")}<//></div>`;
}

const LOOPBACKS = 100; // of one test: about 3 s at 9,600 baud

/** Test of the line to a drive that returns requests unchanged. */
function Loopback({ id }) {
  const [result, setResult] = useState(null);
  const [execute, busy, error] = useRequest();
  const test = () => execute(async () => setResult(await api.post(drivePath(id, "/loopback/test"), { count: LOOPBACKS }, {
    timeout_ms: 60_000 })));
  return html`<h3>${t("page.loopback")}</h3><p class="soft">${t("page.loopback_help")}</p>
    ${result && html`<div role="status" data-text="loopback"><${Notice}
      kind=${result.error || !result.complete ? "warning" : "good"}>${localized(result.text)}<//></div>`}<${ErrorNote} error=${error} />
    <div class="row"><${Button} busy=${busy} disabled=${!isLive.value} onClick=${test} data-do="loopback">
      ${t("page.loopback_test", { n: LOOPBACKS })}<//></div>`;
}

/** Bits of the status word; of a drive also which of them are set in the word that it reported last. */
function StatusBits({ bits, word }) {
  const columns = [[t("page.status_bit"), (bit) => localized(bit.text), "wide"],
    [t("page.status_mask"), (bit) => html`<code>${bit.mask.toString(16).toUpperCase().padStart(4, "0")}H</code>`]];
  const set = [t("page.status_set"), (bit) => yesOrNo(word === null ? null : (word & bit.mask) !== 0)];
  return html`<h3>${t("page.status_bits")}</h3><${Table} stacks caption=${t("page.status_bits")} rows=${bits}
    keyOf=${(bit) => bit.name} columns=${word === undefined ? columns : [...columns, set]} />`;
}

export function ProfileTab({ view, profile }) {
  const state = reading(view, "state");
  return html`<${ModelProfile} profile=${profile} word=${state?.quality === "good" ? state.value : null}>
    ${profile.capabilities.includes("identify") && may("operate") && html`<${Identity} key=${view.id} id=${view.id} />`}
    ${profile.has_loopback && may("operate") && html`<${Loopback} key=${`loopback-${view.id}`} id=${view.id} />`}
    <p><a href=${href("models")}>${t("page.models_back")}</a></p><//>`;
}

export function ModelProfile({ profile, word, children }) {
  return html`<div class="stack"><${Facts} profile=${profile} />${children}
    ${profile.caveats.length > 0 && html`<h3>${t("page.caveats")}</h3>${profile.caveats.map((caveat) => html`
      <${Notice} key=${caveat.id} kind="warning"><p>${localized(caveat.text)}</p>
      <${EvidenceNote} evidence=${caveat.evidence} /><//>`)}`}
    ${profile.keypad.length > 0 && html`<h3>${t("page.keypad")}</h3><ol>${profile.keypad.map((text, n) => html`<li
      key=${n}>${localized(text)}</li>`)}</ol>`}
    ${profile.wiring && html`<h3>${t("page.wiring")}</h3><p>${localized(profile.wiring)}</p>`}
    ${profile.open_questions.length > 0 && html`<h3>${t("page.open_questions")}</h3>
      ${profile.open_questions.map((question) => html`
      <${Notice} key=${question.name} title=${localized(question.text)}><p>${localized(question.reason)}</p><p>${localized(question.procedure)}</p>
        <//>`)}`}
    <h3>${t("page.signals")}</h3><${Table} stacks caption=${t("page.signals")} rows=${profile.signals}
      keyOf=${(signal) => signal.name} columns=${[
      [t("page.signal"), (signal) => localized(signal.text) || signal.name, "wide"], [t("page.notation"), (signal) => html`<code>
        ${signal.notation}</code>`],
      [t("page.wire_address"), (signal) => html`<code>${signal.address_hex}</code>`], [t("page.unit"), (signal) => signal.unit],
      [t("page.period"), (signal) => `${signal.period_s} s`, "right"],
    ]} />${profile.status_bits.length > 0 && html`<${StatusBits} bits=${profile.status_bits} word=${word} />`}</div>`;
}
