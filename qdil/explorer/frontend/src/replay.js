// Plays the iteration slider of a page from beginning to end, as ipywidgets' play button does in a notebook.

const PAUSE = 60; // milliseconds from one picture to the next
const PICTURES = 200; // at most, of a whole run

/** Makes `button` play `slider`. Returns what stops it for good. */
export function replay(button, slider) {
  let timer = 0;

  function stop() {
    clearInterval(timer);
    timer = 0;
    button.textContent = "▶";
    button.setAttribute("aria-pressed", false);
  }

  function next() {
    const last = Number(slider.max);
    slider.value = Math.min(Number(slider.value) + Math.max(1, Math.round(last / PICTURES)), last);
    slider.dispatchEvent(new Event("input"));
    if (Number(slider.value) === last) stop();
  }

  button.addEventListener("click", () => {
    if (timer) return stop();
    if (slider.value === slider.max) slider.value = 0;
    button.textContent = "❚❚";
    button.setAttribute("aria-pressed", true);
    timer = setInterval(next, PAUSE);
  });
  return stop;
}
