// Arrow keys move the focus among elements in rows, such as tiles or check boxes.

const COLUMN_STEP = { ArrowRight: 1, ArrowLeft: -1 };
const ROW_STEP = { ArrowDown: 1, ArrowUp: -1 };

/** Handler of the keys in a container, for its elements with this selector: up and down by the rows on the screen. */
export const moveFocusAmong = (selector) => (event) => {
  const elements = [...event.currentTarget.querySelectorAll(selector)];
  const at = elements.indexOf(document.activeElement);
  if (at < 0) return;
  const next = event.key in COLUMN_STEP ? elements[at + COLUMN_STEP[event.key]] : inNextRow(elements, at, ROW_STEP[event.key]);
  if (!next) return;
  event.preventDefault();
  next.focus();
};

function inNextRow(elements, at, side) {
  if (!side) return null;
  const here = elements[at].getBoundingClientRect();
  const order = side > 0 ? elements.slice(at + 1) : elements.slice(0, at).reverse();
  return order.find((element) => {
    const box = element.getBoundingClientRect();
    return side * (box.top - here.top) > 4 && Math.abs(box.left - here.left) < here.width / 2;
  });
}
