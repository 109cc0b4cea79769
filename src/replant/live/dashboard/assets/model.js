// G(s), typeset, and the table of its poles.
import { known, number, parts, share, tick } from "./format.js";
import { element } from "./served.js";

const MATH = "http://www.w3.org/1998/Math/MathML";
const LINE = 46; // digits that a line of a polynomial may be wide

function math(tag, ...children) {
  const made = document.createElementNS(MATH, tag);
  made.append(...children);
  return made;
}

function figure(value) {
  const [mantissa, power] = parts(value);
  if (!power) return [math("mn", mantissa)];
  const raised = power < 0 ? math("mrow", math("mo", "−"), math("mn", String(-power))) : math("mn", String(power));
  return [math("mn", mantissa), math("mo", "×"), math("msup", math("mn", "10"), raised)];
}

function term(value, power, first) {
  const sign = value < 0 ? [math("mo", "−")] : first ? [] : [math("mo", "+")];
  const symbol = power === 0 ? [] : [power === 1 ? math("mi", "s") : math("msup", math("mi", "s"), math("mn", String(power)))];
  const size = Math.abs(value), factor = symbol.length && number(size) === "1.000" ? [] : figure(size);
  const space = math("mspace");
  space.setAttribute("width", "0.15em");
  return { parts: [...sign, ...factor, ...(factor.length && symbol.length ? [space] : []), ...symbol],
    width: 4 + (factor.length ? number(size).length : 0) };
}

/** A polynomial in s, in as many lines as it needs. */
function polynomial(coefficients) {
  const lines = [{ parts: [], width: 0 }], order = coefficients.length - 1;
  coefficients.forEach((value, i) => {
    if (value === 0) return;
    const next = term(value, order - i, lines.length === 1 && !lines[0].parts.length), last = lines.at(-1);
    if (last.parts.length && last.width + next.width > LINE) lines.push(next);
    else { last.parts.push(...next.parts); last.width += next.width; }
  });
  const width = Math.max(1, ...lines.map(line => line.width));
  if (!lines[0].parts.length) return { width, row: math("mn", "0") };
  if (lines.length === 1) return { width, row: math("mrow", ...lines[0].parts) };
  return { width, row: math("mtable", ...lines.map(line => math("mtr", math("mtd", math("mrow", ...line.parts))))) };
}

/** Typeset G(s) into an element; the letters shrink if it is narrow. */
export function typeset(room, view) {
  const usable = [view.num, view.den].every(p => p?.length && p.every(known)) && view.den.some(value => value !== 0);
  if (!usable) {
    room.replaceChildren(element("p", { class: "nothing" }, "No model yet"));
    return;
  }
  const num = polynomial(view.num), den = polynomial(view.den);
  const open = math("mo", "("), close = math("mo", ")");
  const whole = math("mrow", math("mi", "G"), open, math("mi", "s"), close, math("mo", "="), math("mfrac", num.row, den.row));
  for (const bracket of [open, close]) bracket.setAttribute("stretchy", "false");
  if (view.delay) {
    whole.append(math("msup", math("mi", "e"), math("mrow", math("mo", "−"), math("mn", tick(+view.delay.toPrecision(4))), math("mi", "s"))));
  }
  const formula = math("math", whole);
  formula.setAttribute("display", "block");
  room.style.setProperty("--longest", String(Math.max(num.width, den.width) + 7 + (view.delay ? 7 : 0)));
  room.replaceChildren(formula);
}

/** A cell with a value and, below it, its standard deviation in percent. */
function cell(value, unit = "", std = NaN) {
  const spread = known(std) && known(value) && value ? [element("small", {}, `± ${share(Math.abs(std / value))}`)] : [];
  return element("td", {}, known(value) ? `${number(value)} ${unit}` : String(value), ...spread);
}

const spread = (slope, c) => {
  const variance = slope[0] ** 2 * c[0][0] + 2 * slope[0] * slope[1] * c[0][1] + slope[1] ** 2 * c[1][1];
  return Math.sqrt(Math.max(variance, 0));
};

/** One row a pole, a conjugate pair in one: the pole, its time constant or frequency, its damping. */
export function fillModes(body, view) {
  const rows = [];
  view.poles?.forEach(({ real: x, imag: y }, i) => {
    if (!known(x) || !known(y) || y < 0) return;
    const c = view.pole_covariance?.[i] ?? [[NaN, NaN], [NaN, NaN]], size = Math.hypot(x, y);
    const cells = y
      ? [cell(size / 2 / Math.PI, "Hz", spread([x / size, y / size], c) / 2 / Math.PI), cell(-x / size, "", spread([-(y ** 2) / size ** 3, x * y / size ** 3], c))]
      : [x ? cell(-1 / x, "s", spread([1 / x ** 2, 0], c)) : cell("∞"), cell(x < 0 ? "real" : x > 0 ? "unstable" : "integrator")];
    rows.push(element("tr", {}, element("th", { scope: "row" }, y ? `${number(x, 3)} ± ${number(y, 4)}i` : number(x, 4)), ...cells));
  });
  body.replaceChildren(...rows);
}
