// The plant's configuration: what is in force, whether another text would be right, and taking the file over.
import { html, useEffect, useState } from "../lib.js";
import { both, t } from "../i18n.js";
import { api } from "../api.js";
import { trusted } from "../live.js";
import { Button, ErrorNote, Field, Loading, Notice, useAsk, useLoaded } from "../ui.js";

export function Configuration() {
  const [found, error, reload] = useLoaded(() => api.get("/configuration"), []);
  const [text, setText] = useState(null);
  useEffect(() => { if (found && text === null) setText(found.text); }, [found]);
  if (!found || text === null) return error ? html`<${ErrorNote} error=${error} />` : html`<${Loading} />`;
  return html`<div class="stack"><section class="panel stack"><h2>${t("plantpage.configuration")}</h2>
      <p>${t("plantpage.configuration_how", { file: found.source ?? "plant.toml" })}</p>
      <${Check} text=${text} onChange=${setText} isChanged=${text !== found.text}
        onBack=${() => setText(found.text)} /></section>
    <${Reload} onDone=${() => { setText(null); reload(); }} /></div>`;
}

function Check({ text, onChange, isChanged, onBack }) {
  const [run, busy, error, result, clear] = useAsk();
  return html`<${Field} label="plant.toml"><textarea class="mono" rows="18" spellcheck="false" wrap="off" value=${text}
      onInput=${(event) => { clear(); onChange(event.target.value); }}></textarea><//>
    <div class="row"><${Button} busy=${busy} onClick=${() => run(() => api.post("/configuration/check", { text },
      { patience_ms: 60_000 }))}
      data-configuration="check">${t("plantpage.check")}<//>
      <${Button} disabled=${!isChanged} onClick=${() => { clear(); onBack(); }}>${t("plantpage.back_to_file")}<//></div>
    <${ErrorNote} error=${error} />${result && html`<${Found} result=${result} />`}`;
}

/** Every mistake with its line, what was found and expected, and the remedy; else what taking it over would change. */
function Found({ result }) {
  const complaints = result.complaints ?? [];
  if (complaints.length === 0) {
    return html`<${Notice} kind="good" live title=${t("plantpage.configuration_good")}><${Difference}
      difference=${result.difference} /><//>`;
  }
  return html`<${Notice} kind="bad" live title=${t("plantpage.configuration_bad", { n: complaints.length })}>
    <ol class="complaints">${complaints.map((one, n) => html`<li key=${n}>
      ${one.line != null && html`<b>${t("plantpage.line_n", { n: one.line })}</b>${" "}`}<span>${both(one.text)}</span>
        </li>`)}</ol><//>`;
}

function Difference({ difference }) {
  const lines = Object.entries(difference ?? {}).filter(([, names]) => names.length > 0);
  if (lines.length === 0) return html`<p>${t("plantpage.no_difference")}</p>`;
  return html`<dl class="facts">${lines.map(([what, names]) => html`<dt
    key=${what}>${t(`plantpage.differs_${what}`)}</dt><dd>${names.join(", ")}</dd>`)}</dl>`;
}

function Reload({ onDone }) {
  const [sure, setSure] = useState(false);
  const [run, busy, error, result] = useAsk();
  const send = async () => {
    setSure(false);
    if (await run(() => api.post("/configuration/reload", {}, { patience_ms: 60_000 }))) onDone();
  };
  return html`<section class="panel stack"><h2>${t("plantpage.reload")}</h2><p>${t("plantpage.reload_how")}</p>
    <label class="check"><input type="checkbox" checked=${sure}
      onChange=${(event) => setSure(event.target.checked)} />${t("plantpage.reload_sure")}</label>
    <div class="row"><${Button} kind="main" busy=${busy} disabled=${!sure || !trusted.value}
      onClick=${send}>${t("plantpage.reload")}<//></div>
    <${ErrorNote} error=${error} />
    ${result && html`<${Notice} kind="good" live title=${t("plantpage.reloaded")}><${Difference}
      difference=${result.difference} />
      ${result.restart?.length > 0
        && html`<p>${t("plantpage.at_restart", { names: result.restart.join(", ") })}</p>`}<//>`}</section>`;
}
