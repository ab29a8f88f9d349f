// Two vertical cursors on a chart, A and B: dragged by mouse and finger, moved by arrow keys.
import { t } from "../i18n.js";
import { moment } from "../format.js";

const NAMES = ["a", "b"];

/** Put the two cursors of a `TrendState` above a plot; returns the function that positions them. */
export function addCursors(over, trend) {
  const lines = Object.fromEntries(NAMES.map((name) => [name, cursorElement(name)]));
  const momentAt = (x) => {
    const { from, to } = trend.window.peek();
    const box = over.getBoundingClientRect();
    return from + (Math.min(1, Math.max(0, (x - box.left) / box.width))) * (to - from);
  };
  for (const name of NAMES) {
    const line = lines[name];
    const move = (at) => { trend.cursors.value = { ...trend.cursors.peek(), [name]: at }; };
    line.addEventListener("pointerdown", (event) => {
      line.setPointerCapture(event.pointerId);
      event.stopPropagation();
    });
    line.addEventListener("mousedown", (event) => event.stopPropagation());
    line.addEventListener("pointermove", (event) => {
      if (line.hasPointerCapture(event.pointerId)) move(momentAt(event.clientX));
    });
    line.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      const { from, to } = trend.window.peek();
      move(Math.min(to, Math.max(from, trend.cursors.peek()[name] + (step * (to - from) * (event.shiftKey ? 20 : 1)) / 400)));
    });
    over.append(line);
  }
  return () => {
    const moments = trend.cursors.peek();
    const { from, to } = trend.window.peek();
    for (const name of NAMES) {
      const share = moments ? (moments[name] - from) / (to - from) : -1;
      const line = lines[name];
      line.hidden = share < 0 || share > 1;
      line.style.left = `${share * 100}%`;
      if (line.hidden) continue;
      line.setAttribute("aria-valuemin", Math.round(from));
      line.setAttribute("aria-valuemax", Math.round(to));
      line.setAttribute("aria-valuenow", Math.round(moments[name]));
      line.setAttribute("aria-valuetext", moment(moments[name]));
    }
  };
}

function cursorElement(name) {
  const line = document.createElement("div");
  line.className = "trend-cursor";
  line.tabIndex = 0;
  line.setAttribute("role", "slider");
  line.setAttribute("aria-label", t(`page.cursor_${name}`));
  line.dataset.name = name.toUpperCase();
  line.hidden = true;
  return line;
}
