// Review of changed parameters: old and new values; written to the drive's RAM, and saved to EEPROM in a separate step.
import { html, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api, drivePath } from "../api.js";
import { numberOf } from "../format.js";
import { may } from "../session.js";
import { Button, Dialog, ErrorNote, Notice, OutcomeNote, Table, useRequest, withWholeNumbers } from "../ui.js";
import { rangeText, valueText } from "./parameter-text.js";

const valuesOf = (changes) => Object.fromEntries(changes.map(({ parameter, value }) => [parameter.notation, value]));
const isWritten = (outcome) => outcome.status === "confirmed" || outcome.status === "acknowledged";
const WRITE_TIMEOUT_MS = 60_000;

function Diff({ changes }) {
  const before = ({ parameter, before: was }) => (was === null || was.value === null ? t("page.not_read")
    : html`<s>${valueText(parameter, was.value, was.raw)}</s> ${parameter.unit}`);
  const wrong = ({ parameter, text }) => (numberOf(text) === null ? `${text}${t("page.colon")}${t("page.not_number")}`
    : t("page.outside", { value: text, range: rangeText(parameter) }));
  return html`<${Table} stacks caption=${t("page.changes")} rows=${changes} keyOf=${({ parameter }) => parameter.notation}
    columns=${[
    [t("page.notation"), ({ parameter }) => html`<code>${parameter.notation}</code>`],
    [t("page.parameter"), ({ parameter }) => withWholeNumbers(localized(parameter.text)), "wide"],
    [t("page.before"), before, "right"],
    [t("page.after"), (change) => (change.value === null ? html`<span class="alarmtext">${wrong(change)}</span>`
      : html`<b>${valueText(change.parameter, change.value)}</b> ${change.parameter.unit}`), "right"],
  ]} />`;
}

/** `save`: to EEPROM; else to RAM, where it is lost when the drive loses power. */
function Step({ view, changes, save, text, disabled, onWritten, kind = "main" }) {
  const [execute, busy, error, result] = useRequest();
  const write = async (force) => {
    const found = await execute(() => api.post(drivePath(view.id, "/parameters/write"), {
      values: valuesOf(changes), save, force }, { timeout_ms: WRITE_TIMEOUT_MS }));
    if (found && isWritten(found.outcome)) onWritten();
  };
  return html`<div class="stack"><div class="row end"><${Button} kind=${kind} busy=${busy} disabled=${disabled}
    onClick=${() => write(false)} data-do=${save ? "save" : "write"}>${text}<//></div><${ErrorNote} error=${error} />
    ${error?.kind === "ConfirmationRequired" && html`<div class="row end"><${Button} kind="plain"
      onClick=${() => write(true)} data-do="write-force">${t("page.write_force")}<//></div>`}
    <${OutcomeNote} outcome=${result?.outcome} /></div>`;
}

export function Review({ view, profile, changes: given, onClose, onDone }) {
  const [changes] = useState(given);
  const [isWritten, setWritten] = useState(false);
  const [isSaved, setSaved] = useState(false);
  const names = changes.map(({ parameter }) => parameter.notation);
  const isWrong = changes.some(({ value }) => value === null);
  const ram = profile.can_write_ram;
  const eeprom = profile.can_save && may("save");
  const close = () => { if (isWritten) onDone(names); onClose(); };
  return html`<${Dialog} title=${t("page.review", { n: changes.length })} onClose=${close} class="wide"><${Diff}
    changes=${changes} />
    <p class="soft">${t("page.write_moves")}</p>
    ${ram && html`<${Step} view=${view} changes=${changes} save=${false} text=${t("page.write_ram")}
      disabled=${isWrong || isWritten} onWritten=${() => setWritten(true)} />`}
    ${!ram && !profile.can_save && html`<${Notice} kind="warning">${t("page.not_writable")}<//>`}
    ${profile.can_save && (!ram || isWritten) && html`<${Notice} kind="warning" title=${t("page.save_title")}>
      ${t(ram ? "page.save_note" : "page.save_only")}<//>
      ${eeprom ? html`<${Step} view=${view} changes=${changes} save text=${t("page.save")} kind="plain"
        disabled=${isWrong || isSaved}
        onWritten=${() => { setWritten(true); setSaved(true); }} />` : html`<p>${t("page.save_no_right")}</p>`}`}
    <div class="row end"><${Button} kind="quiet" onClick=${close}>${t("page.close")}<//></div><//>`;
}
