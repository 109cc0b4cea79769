// Measured and simulated output, residual, reference and input over the newest samples; time counts back from the newest.
import { number, tick, timeLabel } from "./format.js";
import { chart, extent, labelled, legend, line, seen, steady, unlabelled } from "./chart.js";
import { at } from "./served.js";
import { TIMES } from "./span.js";

const keyPlace = name => document.querySelector(`[data-for="${name}"]`);

/** Whether at least half of one range lies inside another: a set-point then belongs beside the output that follows it. */
function shares([low, high], [from, to]) {
  if (low === null || from === null) return true;
  return low === high ? low >= from && low <= to : Math.min(high, to) - Math.max(low, from) >= 0.5 * (high - low);
}

const wider = ([low, high], [from, to]) => (from === null ? [low, high] : [Math.min(low ?? from, from), Math.max(high ?? to, to)]);

export function signalPlots(span) {
  const blank = at("input").closest("figure").cloneNode(true), more = []; // plots of the inputs after the first
  const say = {
    output: legend(keyPlace("output"), [{ role: "measured", label: "measured", kind: "thick" }, { role: "model", label: "simulated" },
      { role: "muted", label: "reference", kind: "dashed" }, { role: "shade", label: "left out", kind: "shade" }]),
    residual: legend(keyPlace("residual"), [{ role: "residual", label: "" }, { role: "muted", label: "± 3σ", kind: "dashed" }]),
    reference: legend(keyPlace("reference"), [{ role: "muted", label: "" }]),
    input: legend(keyPlace("input"), [{ role: "input", label: "" }]),
  };
  const keyOf = (name, kind) => document.querySelector(`[data-for="${name}"] i.${kind}`).parentElement;
  const shadeKey = keyOf("output", "shade"), referenceKey = keyOf("output", "dashed"), sigmaKey = keyOf("residual", "dashed");
  const fit = { output: steady(), residual: steady(), reference: steady(), input: steady() };
  const limits = { output: [0, 1], residual: [-1, 1], reference: [0, 1], input: [0, 1] };
  let x = [-1, 0], end = 0, sigma = null, leftOut = [], shown = { u: [], y: [], model: [], residual: [], r: [] };
  const newest = (column, i) => number(column?.[i ?? column.length - 1], 4);
  const choose = range => span.zoom.set(range && range.map(value => value + end));
  const plot = (name, series, read, more) => chart(at(name), { series, x: unlabelled, y: labelled, cursor: "time", choose,
    limits: () => [x, limits[name]], leftOut: () => leftOut, read, ...more });
  const ruled = { dash: [5, 3], width: 1.25 };
  const output = plot("output", [line("measured", { width: 2.25 }), line("model", { width: 1.75 }), line("muted", ruled)],
    i => say.output(newest(shown.y, i), newest(shown.model, i), newest(shown.r, i)));
  const residual = plot("residual", [line("residual", { width: 1.25 }), line("muted", ruled), line("muted", ruled)],
    i => say.residual(newest(shown.residual, i), number(sigma && 3 * sigma, 2)));
  const reference = plot("reference", [line("muted", { width: 1.25 })], i => say.reference(newest(shown.r, i))); // not of the size of the output, as a dither
  const inputPlot = (name, u) => plot(name, [line("input", { width: 1.25, paths: uPlot.paths.stepped({ align: 1 }) })], i => say[name](newest(u(), i)),
    { x: { incrs: TIMES, values: (_, ticks) => ticks.map(t => (t ? timeLabel(t, 0) : "now")) } });
  const input = inputPlot("input", () => shown.u);
  const further = number => {
    const name = `input-${number}`, figure = blank.cloneNode(true), place = figure.querySelector("#input"), label = figure.querySelector("#input-name");
    [place.id, label.id, figure.querySelector(".legend").dataset.for] = [name, `${name}-name`, name];
    at("input").closest("section").append(figure);
    say[name] = legend(keyPlace(name), [{ role: "input", label: "" }]);
    [fit[name], limits[name]] = [steady(), [0, 1]];
    const one = { figure, label, name, u: [] };
    one.chart = inputPlot(name, () => one.u);
    return one;
  };
  const drawMore = (t, inputs, inside) => {
    while (more.length < inputs.length) more.push(further(more.length + 2));
    more.forEach((one, i) => {
      one.figure.hidden = i >= inputs.length;
      if (one.figure.hidden) return;
      one.u = inputs[i].u;
      one.label.textContent = inputs[i].input_label;
      limits[one.name] = fit[one.name](...inside(one.u));
      one.chart.draw([t, one.u]);
    });
  };
  return {
    get charts() { return [output, residual, reference, input, ...more.map(one => one.chart)]; },
    draw({ window, residual_std: std, more_inputs: inputs = [] }) {
      end = window.t.at(-1) ?? 0;
      span.tell(end - (window.t[0] ?? end));
      x = span.of(window.t[0] ?? end - 1, end).map(value => value - end);
      const t = window.t.map(value => value - end), none = t.map(() => null), r = window.r ?? [], inside = column => extent(seen(t, x, column));
      const follows = shares(extent(r), extent(window.y));
      shown = { ...window, r };
      referenceKey.hidden = !r.length || !follows;
      at("apart").hidden = !r.length || follows;
      leftOut = (window.left_out ?? []).map(stretch => stretch.map(value => value - end));
      shadeKey.hidden = !leftOut.length;
      sigma = std ?? null;
      sigmaKey.hidden = sigma === null;
      const [low, high] = inside(window.y), all = wider(inside(window.y), inside(window.model)), room = 0.5 * (high - low);
      // the limits follow the measured output alone: a diverging model leaves the picture
      const ends = low === null ? all : [Math.max(all[0], low - room), Math.min(all[1], high + room)];
      limits.output = fit.output(...wider(ends, follows ? inside(r) : [null, null]));
      const [least, most] = inside(window.residual), reach = Math.max(Math.abs(least ?? 0), Math.abs(most ?? 0), 3.3 * (sigma ?? 0)) || 1;
      limits.residual = fit.residual(-reach, reach);
      limits.input = fit.input(...inside(window.u));
      limits.reference = fit.reference(...inside(r));
      output.draw([t, window.y, window.model, r.length && follows ? r : none]);
      residual.draw([t, window.residual ?? none, ...[3, -3].map(sign => (sigma === null ? none : t.map(() => sign * sigma)))]);
      reference.draw([t, r.length ? r : none]);
      input.draw([t, window.u]);
      drawMore(t, inputs, inside);
    },
  };
}
