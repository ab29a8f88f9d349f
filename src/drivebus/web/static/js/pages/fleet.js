// Fleet: one tile per drive.
import { html, signal, useEffect, useMemo, useRef } from "../lib.js";
import { t } from "../i18n.js";
import { moveFocusAmong } from "../arrow-keys.js";
import { Icon } from "../icons.js";
import { Button, Choice, Field, Loading } from "../ui.js";
import { connection } from "../live.js";
import { go } from "../router.js";
import { idsOf } from "../store.js";
import { driveTitle, groupTitle } from "../titles.js";
import { GroupPanel } from "../fleet/group-panel.js";
import { ErrorBoundary } from "../error-boundary.js";
import { Tile } from "../fleet/tile.js";
import {
  GROUPINGS, KINDS, SIZES, SORTS, arrangement, groupBy, counts, savePreferences, kind, search, sectionTitle, size, sort,
} from "../fleet/fleet-filter.js";

function Kinds() {
  const options = KINDS.map((name) => [name, html`${t(`page.kind_${name}`)} <b>${counts.value[name]}</b>`]);
  return html`<${Choice} label=${t("page.show")} value=${kind.value} options=${options}
    onChange=${(name) => { kind.value = name; }} />`;
}

function OptionSelect({ label, from, names, start }) {
  return html`<${Field} label=${label}><select value=${from.value} onChange=${(event) => {
    from.value = event.currentTarget.value;
    savePreferences();
  }}>${names.map((name) => html`<option key=${name} value=${name}>${t(`page.${start}_${name}`)}</option>`)}</select>
    <//>`;
}

function GroupPick({ chosen }) {
  const groups = idsOf("groups").value;
  if (groups.length === 0) return null;
  return html`<${Field} label=${t("page.group")}><select value=${chosen ?? ""}
    onChange=${(event) => go("fleet", null, { group: event.currentTarget.value })}>
    <option value="">${t("page.every_group")}</option>
    ${groups.map((id) => html`<option key=${id} value=${id}>${groupTitle(id)}</option>`)}</select><//>`;
}

/** On a small screen the drives come first: the filters open by a press. */
const showsMore = signal(false);

/** "/" focuses the search, except while the user types. */
function useSearchShortcut(input) {
  useEffect(() => {
    const key = (event) => {
      if (event.key !== "/" || /^(INPUT|TEXTAREA|SELECT)$/.test(document.activeElement?.tagName)) return;
      event.preventDefault();
      input.current?.focus();
    };
    addEventListener("keydown", key);
    return () => removeEventListener("keydown", key);
  }, []);
}

function Toolbar({ chosen }) {
  const input = useRef(null);
  useSearchShortcut(input);
  const toggle = () => { showsMore.value = !showsMore.value; };
  return html`<section class="fleettools" aria-label=${t("page.fleet_tools")}><${Kinds} />
    <button type="button" class="button morepicks" aria-expanded=${showsMore.value ? "true" : "false"} onClick=${toggle}>
      ${t("page.fleet_tools")}<${Icon} name="more" /></button>
    <div class=${`fleetpicks ${showsMore.value ? "open" : ""}`}><${Field} label=${t("page.search")}><input ref=${input}
      type="search" value=${search.value} onInput=${(event) => { search.value = event.currentTarget.value; }} /><//>
    <${GroupPick} chosen=${chosen} />
    <${OptionSelect} label=${t("page.sort")} from=${sort} names=${SORTS} start="sort" />
    <${OptionSelect} label=${t("page.sections")} from=${groupBy} names=${GROUPINGS} start="by" />
    <${OptionSelect} label=${t("page.size")} from=${size} names=${SIZES} start="size" /></div></section>`;
}

const moveFocus = moveFocusAmong(".tilelink");

function Section({ name, ids }) {
  const title = name === "rest" ? t("page.no_group") : sectionTitle(name);
  return html`<section class="fleetsection">${name && html`<h2>${title} <small>${ids.length}</small></h2>`}
    <div class=${`tiles ${size.value}`}>${ids.map((id) => html`<${ErrorBoundary} key=${id} title=${driveTitle(id)}>
      <${Tile} id=${id} /><//>`)}</div></section>`;
}

const clear = () => { search.value = ""; kind.value = "all"; go("fleet"); };

/** Texts of the active filters. */
function filters(inGroup) {
  return [
    search.value.trim() && t("page.filter_search", { text: search.value.trim() }),
    inGroup && groupTitle(inGroup),
    kind.value !== "all" && t(`page.kind_${kind.value}`),
  ].filter(Boolean);
}

/** Note about drives hidden by filters, which a small screen collapses. */
function Filtered({ chosen, shown }) {
  const by = filters(chosen);
  if (by.length === 0) return null;
  const known = { n: new Set(shown.flatMap(([, ids]) => ids)).size, total: idsOf("drives").value.length };
  return html`<div class="filtered"><span role="status">${t("page.filtered", { ...known,
      by: by.join(t("language.between_items")) })}</span>
    <${Button} icon="close" onClick=${clear}>${t("page.show_all")}<//></div>`;
}

function Empty() {
  if (connection.value === "starting") return html`<${Loading} />`;
  return html`<p class="loading">${t("page.no_drive_shown")} <${Button} onClick=${clear}>${t("page.show_all")}<//></p>`;
}

export function Page({ query }) {
  const chosen = query.group ?? null;
  const shown = useMemo(() => arrangement(chosen), [chosen]);
  return html`<h1 class="sr">${t("page.nav_fleet")}</h1><${Toolbar} chosen=${chosen} />
    <${Filtered} chosen=${chosen} shown=${shown.value} />
    ${chosen && html`<${GroupPanel} key=${chosen} id=${chosen} />`}
    <div class="fleet" onKeyDown=${moveFocus}>${shown.value.map(([name, ids]) => html`
      <${Section} key=${name} name=${name} ids=${ids} />`)}${shown.value.length === 0 && html`<${Empty} />`}</div>`;
}
