// Which stretch of time the plots over time show: the last seconds or minutes, all that is kept, or one chosen by dragging.
import { zoom } from "./chart.js";
import { shortly } from "./format.js";

export const TIMES = [1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600,
  7200, 14400, 28800, 86400, 172800, 432000, 864000];
const SPANS = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000, 86400];

/** The buttons of a toolbar choose the last data-last seconds; a zoom, in rig time, goes before that. */
export function timeSpan(bar, changed) {
  let last = Infinity;
  const hint = bar.querySelector(".hint"), usual = hint.textContent;
  const whole = bar.querySelector("#unzoom");
  const chosen = zoom(() => { whole.hidden = !chosen.range; changed(); });
  whole.addEventListener("click", chosen.reset);
  for (const button of bar.querySelectorAll("[data-last]")) {
    button.addEventListener("click", () => {
      last = Number(button.dataset.last);
      for (const other of bar.querySelectorAll("[data-last]")) other.setAttribute("aria-pressed", String(other === button));
      if (chosen.range) chosen.set(null);
      else changed();
    });
  }
  return {
    zoom: chosen,
    /** Say where less is kept of the signals than was chosen. */
    tell(length) {
      const short = Number.isFinite(last) && length < 0.97 * last;
      hint.textContent = short ? `of the signals the newest ${shortly(length)} are kept` : usual;
      hint.classList.toggle("usual", !short);
    },
    /** From when to when, in rig time, of what is kept from begin to end; rounded up as the samples come in. */
    of(begin, end, rounded = true) {
      if (chosen.range && chosen.range[1] > begin && chosen.range[0] < end) return chosen.range;
      const length = end - begin, round = rounded ? SPANS.find(candidate => candidate >= 0.97 * length) ?? length : length;
      return [end - Math.min(last, Math.max(round, 1e-3)), end];
    },
  };
}
