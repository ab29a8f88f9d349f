// Filter and order of the fleet's drives: strings and numbers only, so that equal values redraw nothing.
import { computed, signal } from "../lib.js";
import { titleOf } from "../i18n.js";
import { TURNING_STATES } from "../drive-states.js";
import { loadPreference, savePreference } from "../preferences.js";
import { now, isLive } from "../live.js";
import { hasUnacknowledgedAlarm } from "../alarms/alarm-list.js";
import { route } from "../router.js";
import { hasWords } from "../search.js";
import { drive, group, idsOf, bus } from "../store.js";
import { collator } from "../titles.js";

const preferences = loadPreference("fleet", {});
export const search = signal("");
export const kind = signal("all");
export const sort = signal(preferences.sort ?? "plant");
export const groupBy = signal(preferences.by ?? "none");
export const size = signal(preferences.size ?? "normal");

export const KINDS = ["all", "abnormal", "unacknowledged", "running", "stopped", "unknown", "fault", "offline"];
export const SORTS = ["plant", "urgency", "name", "bus", "frequency", "current"];
export const SIZES = ["wall", "normal", "dense"];
export const GROUPINGS = ["none", "group", "bus"];

export function savePreferences() {
  savePreference("fleet", { sort: sort.value, by: groupBy.value, size: size.value });
}

/** The kinds that a drive belongs to. A drive whose alarms are all cleared is not abnormal, but they wait for their
 * acknowledgement. */
export function kindsOf(view) {
  const found = new Set(["all"]);
  if (view.presence !== "online") found.add("offline");
  else if (view.state === "fault" || view.fault) found.add("fault");
  else if (TURNING_STATES.includes(view.state)) found.add("running");
  else if (view.state === "stopped" || view.state === "unknown") found.add(view.state);
  if (found.has("offline") || found.has("fault") || Object.keys(view.alarms ?? {}).length) found.add("abnormal");
  if (hasUnacknowledgedAlarm(view.id)) found.add("unacknowledged");
  return found;
}

const shownDrives = computed(() => idsOf("drives").value.map((id) => drive(id).value).filter(Boolean));

const within = (inGroup) => (view) => !inGroup || view.groups.includes(inGroup);

/** {kind: number} in the group of the address, as text so that equal counts redraw nothing. */
const countsText = computed(() => {
  const counts = Object.fromEntries(KINDS.map((name) => [name, 0]));
  for (const view of shownDrives.value.filter(within(route.value.query.group))) for (const name of kindsOf(view)) counts[name] += 1;
  return JSON.stringify(counts);
});
export const counts = computed(() => JSON.parse(countsText.value));

// Values change all the time: tiles sorted by one move every few seconds only.
const slowTick = computed(() => Math.floor(now.value / 4000));

const urgency = (view) => {
  const kinds = kindsOf(view);
  if (kinds.has("fault")) return 0;
  if (kinds.has("offline")) return 1;
  if (kinds.has("abnormal")) return 2;
  if (kinds.has("unacknowledged")) return 3;
  return kinds.has("running") ? 4 : 5;
};
const valueOf = (view, name) => Number(view.signals?.[name]?.value ?? -1);
const ORDERS = {
  urgency: (a, b) => urgency(a) - urgency(b),
  name: (a, b) => collator.compare(titleOf(a), titleOf(b)),
  bus: (a, b) => collator.compare(a.bus, b.bus) || a.address - b.address,
  frequency: (a, b) => valueOf(b, "output_frequency") - valueOf(a, "output_frequency"),
  current: (a, b) => valueOf(b, "output_current") - valueOf(a, "output_current"),
};

const searchedText = ({ id, title, bus: busId, model, address }) => (
  `${id} ${title?.en ?? ""} ${title?.zh ?? ""} ${busId} ${model} ${address}`);

function filteredDrives(inGroup) {
  return shownDrives.value.filter((view) => (
    kindsOf(view).has(kind.value) && within(inGroup)(view) && hasWords(searchedText(view), search.value)
  ));
}

function ordered(views) {
  const order = ORDERS[sort.value];
  return order ? [...views].sort(order) : views;
}

function sections(views) {
  const of = (id) => views.filter((view) => view.bus === id);
  if (groupBy.value === "bus") return idsOf("buses").value.map((id) => [`bus ${id}`, of(id)]);
  if (groupBy.value !== "group") return [["", views]];
  const groups = idsOf("groups").value;
  const inGroups = groups.map((id) => [`group ${id}`, views.filter((view) => view.groups.includes(id))]);
  return [...inGroups, ["rest", views.filter((view) => view.groups.length === 0)]];
}

/** Orders by a live value: it changes all the time, the order only at a slow tick. */
const LIVE_SORTS = new Set(["frequency", "current"]);
let before = { key: "", text: "[]" };

function arrangementText(inGroup) {
  const key = JSON.stringify([inGroup, search.value, kind.value, sort.value, groupBy.value, slowTick.value, isLive.value,
    idsOf("drives").value.length]);
  const views = filteredDrives(inGroup);
  if (LIVE_SORTS.has(sort.value) && before.key === key) return before.text;
  const found = sections(ordered(views)).filter(([, list]) => list.length > 0);
  before = { key, text: JSON.stringify(found.map(([name, list]) => [name, list.map((view) => view.id)])) };
  return before.text;
}

/** A computed of [[section, [ids]]…] for the group of the address (or null); changes only with the order. */
export function arrangement(inGroup) {
  const asText = computed(() => arrangementText(inGroup));
  return computed(() => JSON.parse(asText.value));
}

export function sectionTitle(name) {
  const [what, id] = name.split(" ");
  const found = what === "bus" ? bus(id).value : what === "group" ? group(id).value : null;
  return found ? titleOf(found) : id;
}
