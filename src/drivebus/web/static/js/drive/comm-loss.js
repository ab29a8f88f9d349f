// Communication-loss behaviour, its waiver, and frequency limits of a drive.
import { html, useState } from "../lib.js";
import { localized, t, titleOf } from "../i18n.js";
import { api, drivePath } from "../api.js";
import { Button, Dialog, ErrorNote, Field, Notice, useRequest } from "../ui.js";
import { numberOf } from "../format.js";
import { may } from "../session.js";
import { isLive } from "../live.js";
import { CommLossBadge } from "./state-mark.js";
import { CommLossTest } from "./comm-loss-test.js";

const MIN_REASON_LENGTH = 3;

function WaiverForm({ view, onClose }) {
  const [reason, setReason] = useState("");
  const [run, busy, error] = useRequest();
  const send = async (event) => {
    event.preventDefault();
    if (await run(() => api.post(drivePath(view.id, "/waiver"), { reason: reason.trim() }))) onClose();
  };
  return html`<${Dialog} title=${t("page.waiver")} onClose=${onClose}><form class="stack" onSubmit=${send}>
    <p>${t("page.waiver_ask", { name: titleOf(view) })}</p>
    <${Field} label=${t("page.waiver_reason")}><input data-first value=${reason} maxlength="500" required
      minlength=${MIN_REASON_LENGTH}
      onInput=${(event) => setReason(event.currentTarget.value)} /><//><${ErrorNote} error=${error} />
    <div class="row end"><${Button} onClick=${onClose}>${t("page.cancel")}<//>
      <button type="submit" class="button main" disabled=${busy}>${t("page.waiver_record")}</button></div></form><//>`;
}

/** Communication-loss behaviour as text, with its test and the waiver. */
export function CommLoss({ view }) {
  const [asking, setAsking] = useState(false);
  const [run, busy, error] = useRequest();
  const badge = view.comm_loss;
  const needs = badge.kind !== "trips";
  return html`<div class="stack"><div><${CommLossBadge} badge=${badge} /></div><p class="soft">
    ${localized(badge.text)}</p><${CommLossTest} view=${view} />
    ${badge.waiver && html`<${Notice} title=${t("page.waiver")}>${badge.waiver}
      ${may("limit") && html` <${Button} kind="quiet" busy=${busy}
        onClick=${() => run(() => api.remove(drivePath(view.id, "/waiver")))}>
        ${t("page.waiver_withdraw")}<//>`}<//>`}
    ${needs && !badge.waiver && may("limit") && html`<div><${Button} disabled=${!isLive.value}
      onClick=${() => setAsking(true)}
      data-do="waive">${t("page.waiver_record")}…<//></div>`}
    <${ErrorNote} error=${error} />${asking && html`<${WaiverForm} view=${view} onClose=${() => setAsking(false)} />`}
      </div>`;
}

/** Limits in force; an engineer may narrow them. */
export function Limits({ view }) {
  const [open, setOpen] = useState(false);
  const [only, ...more] = view.directions;
  return html`<div class="row"><span>${t("page.limits_now", view)}${view.capabilities.includes("reverse")
    && more.length === 0 && t("page.limits_only", { way: t(`drives.direction_${only}`) })}</span>
    ${may("limit") && html`<${Button} kind="quiet" disabled=${!isLive.value} onClick=${() => setOpen(true)}>
      ${t("page.limits_change")}…<//>`}
    ${open && html`<${LimitsForm} view=${view} onClose=${() => setOpen(false)} />`}</div>`;
}

function LimitsForm({ view, onClose }) {
  const { minimum_hz, maximum_hz } = view;
  const has = (direction) => view.directions.includes(direction);
  const [values, setValues] = useState({
    minimum_hz: String(minimum_hz), maximum_hz: String(maximum_hz), forward: has("forward"), reverse: has("reverse"),
  });
  const [run, busy, error] = useRequest();
  const put = (name, value) => setValues({ ...values, [name]: value });
  const limits = Object.fromEntries(["minimum_hz", "maximum_hz"].map((name) => [name, numberOf(values[name])]));
  const isWrong = Object.values(limits).includes(null) || !(values.forward || values.reverse);
  const send = async (event) => {
    event.preventDefault();
    if (await run(() => api.put(drivePath(view.id, "/limits"), { ...values, ...limits }))) onClose();
  };
  const hertz = (name) => html`<${Field} key=${name} label=${t(`page.${name}`)}
    wrong=${limits[name] === null && t("page.not_number")}><span class="withunit">
    <input inputmode="decimal" autocomplete="off" maxlength="12" value=${values[name]}
      data-first=${name === "minimum_hz"} onInput=${(event) => put(name, event.currentTarget.value)} /><span>Hz</span>
    </span><//>`;
  const direction = (name) => html`<label class="check" key=${name}><input type="checkbox" checked=${values[name]}
    onChange=${(event) => put(name, event.currentTarget.checked)} />${t(`page.allow_${name}`)}</label>`;
  return html`<${Dialog} title=${t("page.limits_change")} onClose=${onClose}><form class="stack" onSubmit=${send}><p>
    ${t("page.limits_note")}</p>
    ${["minimum_hz", "maximum_hz"].map(hertz)}<div class="row">${["forward", "reverse"].map(direction)}</div><${ErrorNote}
      error=${error} />
    <div class="row end"><${Button} onClick=${onClose}>${t("page.cancel")}<//>
      <button type="submit" class="button main" disabled=${busy || isWrong}>${t("page.limits_set")}</button></div></form><//>`;
}
