// Icons of one colour: the shape carries as much meaning as the colour.
import { html } from "./lib.js";

const PATHS = {
  // States: ▶ turning, ■ standing, ! in a diamond: fault, ? unknown, ⌁ offline.
  turning: "M6 3.5v17l15-8.5z",
  standing: "M5 5h14v14H5z",
  ramp_up: "M3 20 21 20 21 4z",
  ramp_down: "M3 4 3 20 21 20z",
  fault: "M12 1 23 12 12 23 1 12zM12 6.5v7M12 16v2",
  warning: "M12 2 23 21H1zM12 9v6M12 17v2",
  low: "M12 22 2 6H22zM12 9v5M12 16v1.5",
  unknown: "M12 2a10 10 0 1 0 0 20 10 10 0 0 0 0-20zM9 9.2a3 3 0 1 1 4.4 2.7c-1 .6-1.4 1.1-1.4 2.3M12 17v1.5",
  silent: "M3 12h4M17 12h4M9.5 8.5l5 7M14.5 8.5l-5 7",
  forward: "M4 12h13M12 6l6 6-6 6",
  reverse: "M20 12H7M12 6l-6 6 6 6",
  stop: "M6 6h12v12H6z",
  close: "M5 5l14 14M19 5 5 19",
  menu: "M3 6h18M3 12h18M3 18h18",
  key: "M14 10a4 4 0 1 0-3.5 4L12 15.500 14 15.500 14 17.500 16 17.500 16 19.500 19 19.500 19 17",
  check: "M4 12.500 9.500 18 20 6.500",
  link: "M3 9a13 13 0 0 1 18 0M6.500 12.500a8 8 0 0 1 11 0M10 16a3.500 3.500 0 0 1 4 0M12 19v.5",
  more: "M6 9l6 6 6-6",
  download: "M12 3v12M7 10l5 5 5-5M4 20h16",
  sound: "M3 9v6h4l6 5V4L7 9zM16.500 8a5 5 0 0 1 0 8M19 5a9 9 0 0 1 0 14",
  silenced: "M3 9v6h4l6 5V4L7 9zM17 9.500l5 5M22 9.500l-5 5",
  eye: "M2 12c5-8 15-8 20 0-5 8-15 8-20 0zM12 9a3 3 0 1 0 0 6 3 3 0 0 0 0-6z",
  eye_off: "M2 12c5-8 15-8 20 0-5 8-15 8-20 0zM12 9a3 3 0 1 0 0 6 3 3 0 0 0 0-6zM4 21 20 3",
  pause: "M7 4v16M17 4v16",
  play: "M7 4v16l13-8z",
  sun: "M12 7a5 5 0 1 0 0 10 5 5 0 0 0 0-10zM12 1v3M12 20v3M1 12h3M20 12h3M4 4l2 2M18 18l2 2M4 20l2-2M18 6l2-2",
};
const SOLID = new Set(["turning", "standing", "stop", "ramp_up", "ramp_down"]);

/** An svg, hidden from screen readers: a text is always beside it. */
export function Icon({ name, size = 20 }) {
  return html`<svg class=${`icon icon-${name}${SOLID.has(name) ? " solid" : ""}`} width=${size} height=${size}
    viewBox="0 0 24 24" aria-hidden="true" focusable="false"><path d=${PATHS[name]} /></svg>`;
}
