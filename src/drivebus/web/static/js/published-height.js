// Height of an element that lies over the page, as a variable of the style sheet: the page ends that much later, so that
// its last row can be scrolled into sight.
import { useEffect } from "./lib.js";

/** Publish the height of the element of `ref` as the variable `name`. */
export function usePublishedHeight(ref, name) {
  useEffect(() => {
    const element = ref.current; // the observer is called once more after the removal, when the reference is empty
    const publish = () => document.documentElement.style.setProperty(name, `${element.offsetHeight}px`);
    const watch = new ResizeObserver(publish);
    watch.observe(element);
    return () => watch.disconnect();
  }, []);
}
