// Parameters as a table: notation, wire address, raw, value, unit, range, help, caveat. They are read on demand, because
// reading takes bus time; edits are reviewed together before they are written.
import { html, useMemo, useRef, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api, drivePath } from "../api.js";
import { NO_VALUE, numberOf } from "../format.js";
import { Icon } from "../icons.js";
import { isLive } from "../live.js";
import { may } from "../session.js";
import { hasControl } from "../control/leases.js";
import { SearchField, hasWords } from "../search.js";
import { Button, ErrorNote, Table, withWholeNumbers } from "../ui.js";
import { EvidenceNote } from "./evidence.js";
import { Range, UncertainNote, valueText } from "./parameter-text.js";
import { Review } from "./review.js";

/** Parameters of one request: a bus at 9,600 baud reads these in about a second. */
const READ_BATCH = 16;

function Cell({ parameter, found }) {
  if (!found) return NO_VALUE;
  if (found.value === null) return html`<span class="soft">${found.reason ? t(found.reason) : NO_VALUE}</span>`;
  return html`<b>${valueText(parameter, found.value, found.raw)}</b><${UncertainNote} ...${found} />`;
}

/** Read parameters in batches: {values, left, error, read, stop}. */
function useReadings(id) {
  const [state, setState] = useState({ values: {}, left: 0, error: null });
  const going = useRef(0);
  const read = async (names) => {
    const mine = ++going.current;
    for (let at = 0; at < names.length && going.current === mine; at += READ_BATCH) {
      setState((old) => ({ ...old, left: names.length - at, error: null }));
      try {
        const part = names.slice(at, at + READ_BATCH);
        const { parameters } = await api.post(drivePath(id, "/parameters/read"), { names: part }, {
        timeout_ms: 60_000 });
        setState((old) => ({ ...old, values: { ...old.values, ...parameters } }));
      } catch (error) {
        setState((old) => ({ ...old, error }));
        break;
      }
    }
    if (going.current === mine) setState((old) => ({ ...old, left: 0 }));
  };
  return { ...state, read, stop: () => { going.current += 1; setState((old) => ({ ...old, left: 0 })); } };
}

function Edit({ parameter, value, onChange }) {
  const name = t("page.new_value", { notation: parameter.notation });
  const choices = Object.entries(parameter.choices);
  const put = (event) => onChange(event.currentTarget.value);
  if (choices.length && parameter.choices_complete) {
    return html`<select aria-label=${name} value=${value} onChange=${put}><option value="">${NO_VALUE}</option>
      ${choices.map(([raw, text]) => html`<option key=${raw} value=${raw}>${raw} ${localized(text)}</option>`)}</select>`;
  }
  return html`<input inputmode="decimal" autocomplete="off" maxlength="16" aria-label=${name} value=${value}
    onInput=${put} aria-invalid=${value !== "" && allowedValue(parameter, value) === null ? "true" : undefined} />`;
}

/** The number of an input's text, or null where it is not one within the range. */
function allowedValue(parameter, text) {
  const value = numberOf(text);
  if (value === null) return null;
  const { minimum, maximum } = parameter;
  return (minimum !== null && value < minimum) || (maximum !== null && value > maximum) ? null : value;
}

function ParameterDetails({ parameter, caveats }) {
  const caveat = caveats.find(({ id }) => id === parameter.caveat);
  const help = localized(parameter.help);
  return html`<span class="paramtext">${withWholeNumbers(localized(parameter.text))}</span>
    ${(help || caveat || parameter.evidence.source) && html`<details class="more"><summary>${caveat ? html`<${Icon}
      name="warning" size=${16} />` : null}
      ${t("page.help")}</summary>${help && html`<p>${help}</p>`}${caveat && html`<p><b>${t("page.caveat")}
        </b> ${localized(caveat.text)}</p>`}
      <${EvidenceNote} evidence=${parameter.evidence} /></details>`}`;
}

function columns({ profile, values, edits, edit, read, canRead, canEdit }) {
  const found = (parameter) => values[parameter.notation];
  const shown = [
    [t("page.notation"), (parameter) => html`<code>${parameter.notation}</code>`, "key"],
    [t("page.wire_address"), (parameter) => html`<code>${parameter.address_hex}</code>`],
    [t("page.parameter"), (parameter) => html`<${ParameterDetails} parameter=${parameter} caveats=${profile.caveats} />`, "wide"],
    [t("page.raw"), (parameter) => found(parameter)?.raw ?? NO_VALUE, "right"],
    [t("page.value"), (parameter) => html`<${Cell} parameter=${parameter} found=${found(parameter)} />`],
    [t("page.unit"), (parameter) => parameter.unit],
    [t("page.range"), (parameter) => html`<${Range} parameter=${parameter} />`, "right"],
    [t("page.factory"), (parameter) => (parameter.factory === null ? NO_VALUE : valueText(parameter, parameter.factory)), "right"],
  ];
  if (canRead) {
    shown.push([t("page.read"), (parameter) => parameter.readable !== false && html`<${Button} kind="quiet"
      onClick=${() => read([parameter.notation])}
      aria-label=${t("page.read_one", { notation: parameter.notation })}>${t("page.read")}<//>`, "corner"]);
  }
  if (canEdit) {
    shown.push([t("page.change_to"), (parameter) => parameter.writable && html`<${Edit} parameter=${parameter}
      value=${edits[parameter.notation] ?? ""} onChange=${(text) => edit(parameter.notation, text)} />`, "pinned"]);
  }
  return shown;
}

const matching = (profile, search) => profile.parameters.filter(({ notation, address_hex, text }) => (
  hasWords(`${notation} ${address_hex} ${text?.en} ${text?.zh}`, search)));

export function ParametersTab({ view, profile }) {
  const [search, setSearch] = useState("");
  const [edits, setEdits] = useState({});
  const [reviewing, setReviewing] = useState(false);
  const { values, left, error, read, stop } = useReadings(view.id);
  const rows = useMemo(() => matching(profile, search), [profile, search]);
  const byName = useMemo(() => new Map(profile.parameters.map((parameter) => [parameter.notation, parameter])), [profile]);
  const canRead = isLive.value && may("operate") && view.presence === "online";
  const canEdit = canRead && may("write_parameters") && hasControl(view);
  const edit = (notation, text) => setEdits((old) => {
    const { [notation]: _, ...others } = old;
    return text === "" ? others : { ...others, [notation]: text };
  });
  const changes = Object.entries(edits).map(([notation, text]) => {
    const parameter = byName.get(notation);
    return { parameter, text, value: allowedValue(parameter, text), before: values[notation] ?? null };
  });
  const names = rows.filter((parameter) => parameter.readable !== false).map((parameter) => parameter.notation);
  return html`<div class="stack"><div class="row"><${SearchField} value=${search} onChange=${setSearch} />
      ${left > 0 ? html`<${Button} onClick=${stop}>${t("page.read_stop", { n: left })}<//>`
        : html`<${Button} disabled=${!canRead || names.length === 0} onClick=${() => read(names)} data-do="read">
        ${t("page.read_shown", { n: names.length })}<//>`}
      ${canEdit && html`<${Button} kind="main" disabled=${changes.length === 0} onClick=${() => setReviewing(true)}
        data-do="review">
        ${t("page.review", { n: changes.length })}<//>`}</div>
    ${!canEdit && may("write_parameters") && html`<p class="soft">${t("page.edit_needs_control")}</p>`}<${ErrorNote} error=${error} />
    <${Table} stacks caption=${t("page.tab_parameters")} rows=${rows} keyOf=${(parameter) => parameter.notation}
      rowClass=${(parameter) => (parameter.notation in edits ? "changed" : undefined)}
        columns=${columns({ profile, values, edits, edit, read, canRead, canEdit })} />
    ${reviewing && html`<${Review} view=${view} profile=${profile} changes=${changes}
      onClose=${() => setReviewing(false)}
      onDone=${(done) => { for (const notation of done) edit(notation, ""); read(done); }} />`}</div>`;
}

/** Parameters of a model that the plant may not have: nothing is read. */
export function ModelParameters({ profile }) {
  return html`<${Table} stacks caption=${t("page.tab_parameters")} rows=${profile.parameters} keyOf=${(parameter) => parameter.notation}
    columns=${[
      [t("page.notation"), (parameter) => html`<code>${parameter.notation}</code>`],
      [t("page.parameter"), (parameter) => localized(parameter.text), "wide"],
      [t("page.range"), (parameter) => html`<${Range} parameter=${parameter} />`],
      [t("page.factory"), (parameter) => (parameter.factory === null ? NO_VALUE : valueText(parameter, parameter.factory, null))],
      [t("page.unit"), (parameter) => parameter.unit],
    ]} />`;
}
