// Two vertical cursors on a chart, A and B: dragged by mouse and finger, moved by arrow keys.
import { t } from "../i18n.js";
import { moment } from "./labels.js";

const NAMES = ["a", "b"];

/** Put two cursors above a plot. `place()` positions them; `moved({a, b})` reports a drag. */
export function cursors(over, { window, cursors: found, moved }) {
  const lines = Object.fromEntries(NAMES.map((name) => [name, made(name)]));
  const at = (x) => {
    const { from, to } = window();
    const box = over.getBoundingClientRect();
    return from + (Math.min(1, Math.max(0, (x - box.left) / box.width))) * (to - from);
  };
  for (const name of NAMES) {
    const line = lines[name];
    const move = (moment) => moved({ ...found(), [name]: moment });
    line.addEventListener("pointerdown", (event) => {
      line.setPointerCapture(event.pointerId);
      event.stopPropagation();
    });
    line.addEventListener("mousedown", (event) => event.stopPropagation());
    line.addEventListener("pointermove", (event) => {
      if (line.hasPointerCapture(event.pointerId)) move(at(event.clientX));
    });
    line.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      const { from, to } = window();
      move(Math.min(to, Math.max(from, found()[name] + (step * (to - from) * (event.shiftKey ? 20 : 1)) / 400)));
    });
    over.append(line);
  }
  const place = () => {
    const now = found();
    const { from, to } = window();
    for (const name of NAMES) {
      const share = now ? (now[name] - from) / (to - from) : -1;
      const line = lines[name];
      line.hidden = share < 0 || share > 1;
      line.style.left = `${share * 100}%`;
      if (line.hidden) continue;
      line.setAttribute("aria-valuemin", Math.round(from));
      line.setAttribute("aria-valuemax", Math.round(to));
      line.setAttribute("aria-valuenow", Math.round(now[name]));
      line.setAttribute("aria-valuetext", moment(now[name]));
    }
  };
  return { place, remove: () => Object.values(lines).forEach((line) => line.remove()) };
}

function made(name) {
  const line = document.createElement("div");
  line.className = "trend-cursor";
  line.tabIndex = 0;
  line.setAttribute("role", "slider");
  line.setAttribute("aria-label", t(`page.cursor_${name}`));
  line.dataset.name = name.toUpperCase();
  line.hidden = true;
  return line;
}
