// The plant's configuration: the text in force, the check of a changed text, and the reload of the file.
import { html, useEffect, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api } from "../api.js";
import { isLive } from "../live.js";
import { session } from "../session.js";
import { Button, ErrorNote, Field, Loading, Notice, useRequest, useLoaded, withCommands } from "../ui.js";

/** Result of a check, with the text that was checked. */
const checkText = async (text) => ({ text, ...await api.post("/configuration/check", { text }, { timeout_ms: 60_000 }) });

/** Changed text `{user, file, text}`, kept while other pages are shown; for its user and the same text of the file only. */
let draft = null;

const draftOf = ({ text }) => (draft?.user === session.value.user && draft.file === text ? draft.text : text);

export function Configuration() {
  const [found, error, reload] = useLoaded(() => api.get("/configuration"), []);
  const [text, setText] = useState(null);
  useEffect(() => { if (found) setText(draftOf(found)); }, [found]);
  if (!found || text === null) return error ? html`<${ErrorNote} error=${error} />` : html`<${Loading} />`;
  const change = (changed) => { draft = { user: session.value.user, file: found.text, text: changed }; setText(changed); };
  return html`<div class="stack"><section class="panel stack"><h2>${t("page.configuration")}</h2>
      <p>${t("page.configuration_how", { file: found.source ?? "plant.toml" })}</p>
      <${Check} text=${text} onChange=${change} isChanged=${text !== found.text}
        onBack=${() => change(found.text)} /></section>
    <${Reload} file=${found.source ?? "plant.toml"} onDone=${reload} /></div>`;
}

function Check({ text, onChange, isChanged, onBack }) {
  const [execute, busy, error, result, clear] = useRequest();
  return html`<${Field} label="plant.toml"><textarea class="mono" rows="18" spellcheck=${false} wrap="off" value=${text}
      onInput=${(event) => { clear(); onChange(event.target.value); }}></textarea><//>
    <div class="row"><${Button} busy=${busy} onClick=${() => execute(() => checkText(text))}
      data-configuration="check">${t("page.check")}<//>
      <${Button} disabled=${!isChanged} onClick=${() => { clear(); onBack(); }}>${t("page.back_to_file")}<//></div>
    <${ErrorNote} error=${error} />${result?.text === text && html`<${CheckResult} result=${result} />`}`;
}

/** Errors with line, found, expected and remedy; without errors the changes that a reload would apply. */
function CheckResult({ result }) {
  const diagnostics = result.diagnostics ?? [];
  if (diagnostics.length === 0) {
    return html`<${Notice} kind="good" live title=${t("page.configuration_good")}><${Difference}
      difference=${result.difference} /><${Notes} notes=${result.notes} /><//>`;
  }
  return html`<${Notice} kind="bad" live title=${t("page.configuration_bad", { n: diagnostics.length })}>
    <ol class="diagnostics">${diagnostics.map((diagnostic, n) => html`<li key=${n}>
      ${diagnostic.line != null && html`<b>${t("page.line_n", { n: diagnostic.line })}</b>${" "}`}<span>${withCommands(localized(diagnostic.text))}</span>
        </li>`)}</ol><//>`;
}

/** What a reload takes from its users: a gateway that moves or ends, such as this page. */
function Notes({ notes }) {
  return (notes ?? []).map((note, n) => html`<p key=${n}><b>${localized(note)}</b></p>`);
}

function Difference({ difference }) {
  const lines = Object.entries(difference ?? {}).filter(([, names]) => names.length > 0);
  if (lines.length === 0) return html`<p>${t("page.no_difference")}</p>`;
  return html`<dl class="facts">${lines.map(([what, names]) => html`<dt
    key=${what}>${t(`page.differs_${what}`)}</dt><dd>${names.join(t("language.between_items"))}</dd>`)}</dl>`;
}

/** Refusals of a check of a file that is too large for it. Its reload has no such limit. */
const SIZE_LIMITS = ["plant.check_too_many", "plant.check_too_long"];

/** Check of the file as it is now, which may be newer than the text of the page; `tooLarge` is the refusal of a large file. */
async function checkFile() {
  const { text } = await api.get("/configuration");
  return checkText(text).catch((error) => {
    if (!SIZE_LIMITS.includes(error.code)) throw error;
    return { text, tooLarge: error };
  });
}

/** What a reload would do, or that the page can't show it. */
function Compared({ compared, file }) {
  if (!compared.tooLarge) return html`<${CheckResult} result=${compared} />`;
  return html`<${Notice} kind="warning" live title=${withCommands(compared.tooLarge.sentence)}>
    <p>${withCommands(t("page.reload_unseen", { file }))}</p><//>`;
}

/** Errors of the check forbid no reload: it refuses them itself, and may read profiles that the check may not. */
function Reload({ file, onDone }) {
  const [sure, setSure] = useState(false);
  const [isOutdated, setOutdated] = useState(false);
  const [execute, busy, error, result, clear] = useRequest();
  const [compare, comparing, compareError, compared, forget] = useRequest();
  const read = () => { clear(); setSure(false); setOutdated(false); return compare(checkFile); };
  const send = async () => {
    const before = JSON.stringify(compared);
    const now = await read();
    if (now === null) return;
    if (JSON.stringify(now) !== before) { setOutdated(true); return; }
    forget();
    if (await execute(() => api.post("/configuration/reload", {}, { timeout_ms: 60_000 }))) onDone();
  };
  return html`<section class="panel stack"><h2>${t("page.reload")}</h2><p>${t("page.reload_how")}</p>
    <div class="row"><${Button} busy=${comparing || busy} onClick=${read}
      data-configuration="compare">${t("page.reload_compare")}<//></div>
    <${ErrorNote} error=${compareError} />${isOutdated && html`<${Notice} kind="warning" live>${t("page.reload_outdated")}<//>`}
    ${compared && html`<${Compared} compared=${compared} file=${file} />`}
    <label class="check"><input type="checkbox" checked=${sure} disabled=${compared === null}
      onChange=${(event) => setSure(event.target.checked)} /><span>${
        withCommands(t(compared?.tooLarge ? "page.reload_sure_unseen" : "page.reload_sure"))}</span></label>
    <div class="row"><${Button} kind="main" busy=${busy} disabled=${!sure || !isLive.value}
      onClick=${send}>${t("page.reload")}<//></div>
    <${ErrorNote} error=${error} />
    ${result && html`<${Notice} kind="good" live title=${t("page.reloaded")}><${Difference}
      difference=${result.difference} />
      ${result.restart?.length > 0
        && html`<p>${t("page.at_restart", { names: result.restart.join(t("language.between_items")) })}</p>`}
      <${Notes} notes=${result.notes} /><//>`}</section>`;
}
