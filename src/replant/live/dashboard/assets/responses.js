// The responses of the model: magnitude and phase over frequency, and the step response; each with its band.
import { number, tick, timeLabel } from "./format.js";
import { chart, colour, edge, extent, labelled, legend, line, seen, steady, ticksOf, truth, unlabelled, zoom } from "./chart.js";
import { ticks } from "./plane.js";
import { at } from "./served.js";
import { TIMES } from "./span.js";

export const DEGREES = [1, 5, 10, 15, 30, 45, 90, 180, 360];
const keyPlace = name => document.querySelector(`[data-for="${name}"]`);
const band = { series: [3, 4], fill: () => colour("model") + "40" };
const isDecade = value => value > 0 && Math.abs(value / 10 ** Math.round(Math.log10(value)) - 1) < 1e-6;

/** The legend of a plot with the model alone: its swatch says nothing. */
function plainLegend(name) {
  const say = legend(keyPlace(name), [{ role: "model", label: "" }, { role: "truth", label: "true", kind: "dashed" }]);
  keyPlace(name).querySelector("i").remove();
  return say;
}

/** Lines at 1, 2 and 5 of every decade, or where a zoom leaves fewer than three of these, evenly. */
export function logTicks(plot, _, low, high) {
  const found = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) {
    for (const m of [1, 2, 5]) if (m * 10 ** power >= 0.999 * low && m * 10 ** power <= 1.001 * high) found.push(m * 10 ** power);
  }
  return found.length > 2 ? found : ticks(low, high, 4);
}

export const decades = (_, ticks) => {
  const whole = ticks.filter(isDecade).length > 1;
  return ticks.map(value => (!whole || isDecade(value) ? tick(+value.toPrecision(6)) : ""));
};

/** Magnitude with its band, and phase; with the truth of a simulated plant. */
export function bodePlots(again) {
  const say = { magnitude: plainLegend("magnitude"), phase: plainLegend("phase") };
  const fit = { magnitude: steady(), phase: steady() }, chosen = zoom(again);
  let ends = [0.1, 10], limits = { magnitude: [-40, 10], phase: [-180, 0] }, shown = { omega: [], magnitude_db: [], phase_deg: [] };
  const where = i => (i === null ? "" : `at ${number(shown.omega[i], 3)} rad/s`);
  const more = { log: true, cursor: "frequency", choose: chosen.set };
  const axis = { splits: logTicks, filter: (_, ticks) => ticks };
  const magnitude = chart(at("magnitude"), {
    series: [line("model"), truth(), edge(), edge()], bands: [band], x: { ...unlabelled, ...axis }, y: labelled, ...more,
    limits: () => [chosen.range ?? ends, limits.magnitude], read: i => say.magnitude(i === null ? "dB" : `${number(shown.magnitude_db[i], 3)} dB ${where(i)}`, ""),
  });
  const phase = chart(at("phase"), {
    series: [line("model"), truth()], x: { ...axis, values: decades }, y: { incrs: DEGREES, values: ticksOf(tick) }, ...more,
    limits: () => [chosen.range ?? ends, limits.phase], read: i => say.phase(i === null ? "degrees over rad/s" : `${number(shown.phase_deg[i], 3)}° ${where(i)}`, ""),
  });
  return {
    charts: [magnitude, phase],
    draw({ bode = { omega: [], magnitude_db: [], phase_deg: [] }, truth: plant }) {
      shown = bode;
      if (bode.omega.length > 1) ends = [bode.omega[0], bode.omega.at(-1)];
      const range = chosen.range ?? ends, inside = column => extent(seen(bode.omega, range, column)), none = bode.omega.map(() => null);
      const [low, high] = inside(bode.magnitude_db), bands = [inside(bode.magnitude_low), inside(bode.magnitude_high)];
      if (low !== null) limits.magnitude = fit.magnitude(Math.max(bands[0][0] ?? low, low - 12), Math.min(bands[1][1] ?? high, high + 12));
      limits.phase = fit.phase(...inside(bode.phase_deg));
      magnitude.draw([bode.omega, bode.magnitude_db, plant?.magnitude_db ?? none, bode.magnitude_high ?? none, bode.magnitude_low ?? none]);
      phase.draw([bode.omega, bode.phase_deg, plant?.phase_deg ?? none]);
    },
  };
}

/** The step response with its band. */
export function stepPlot(again) {
  const say = plainLegend("step"), fit = steady(), chosen = zoom(again);
  let end = 1, limits = [0, 1], shown = { t: [], y: [] };
  const step = chart(at("step"), {
    series: [line("model"), truth(), edge(), edge()], bands: [band], choose: chosen.set, y: labelled,
    x: { incrs: TIMES, values: (_, ticks) => ticks.map(t => timeLabel(t, end)) }, limits: () => [chosen.range ?? [0, end], limits],
    read: i => say(i === null ? "" : `${number(shown.y[i], 4)} after ${number(shown.t[i], 3)} s`, ""),
  });
  return {
    charts: [step],
    draw({ step: response, truth: plant }) {
      shown = response ?? { t: [], y: [], low: [], high: [] };
      const { t, y, low, high } = shown, none = t.map(() => null);
      end = t.at(-1) ?? 1;
      const inside = column => extent(seen(t, chosen.range ?? [0, end], column)), [least, most] = inside(y), room = most - least;
      const bands = [inside(low)[0] ?? least, inside(high)[1] ?? most];
      if (least !== null) limits = fit(Math.max(bands[0], least - 0.5 * room), Math.min(bands[1], most + 0.5 * room));
      step.draw([t, y, plant?.step?.length === t.length ? plant.step : none, high, low]);
    },
  };
}
