// The s-plane: poles with their ellipses of two standard deviations, zeros, lines of equal damping.
import { known, number, tick } from "./format.js";
import { steady } from "./chart.js";

const SVG = "http://www.w3.org/2000/svg";
const DAMPINGS = [0.1, 0.3, 0.5, 0.7, 0.9];
const EDGE = { left: 8, right: 8, top: 6, bottom: 20 };

function shape(tag, attributes, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

/** A shape in the colour of its model, where a point says which role of the palette that is. */
function tinted({ role }, element) {
  if (!role) return element;
  element.style.stroke = `var(--${role})`;
  if (element.getAttribute("class") === "ellipse") element.style.fill = `var(--${role})`;
  return element;
}

/** Where axis ticks lie: about that many, at 1, 2 or 5 times a power of ten. */
export function ticks(low, high, about) {
  const rough = (high - low) / about, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(m => m * power).find(candidate => candidate >= rough), found = [];
  for (let at = Math.ceil(low / step) * step; at <= high + 1e-9 * step; at += step) found.push(Math.abs(at) < 1e-9 * step ? 0 : at);
  return found;
}

/** Half axes and directions of the ellipse of two standard deviations, as points around the pole. */
function ellipse(pole, covariance) {
  const [[xx, xy], [, yy]] = covariance;
  if (![xx, xy, yy].every(known)) return null;
  const middle = (xx + yy) / 2, half = Math.hypot((xx - yy) / 2, xy), angle = Math.atan2(2 * xy, xx - yy) / 2;
  const long = 2 * Math.sqrt(Math.max(middle + half, 0)), wide = 2 * Math.sqrt(Math.max(middle - half, 0));
  return Array.from({ length: 48 }, (_, i) => {
    const turn = (i / 24) * Math.PI, a = long * Math.cos(turn), b = wide * Math.sin(turn);
    return [pole.real + a * Math.cos(angle) - b * Math.sin(angle), pole.imag + a * Math.sin(angle) + b * Math.cos(angle)];
  });
}

/** With each pole above the axis its conjugate below. */
function both(poles, covariances) {
  const found = [];
  poles.forEach((pole, i) => {
    if (!known(pole.real) || !known(pole.imag) || pole.imag < 0) return;
    const outline = covariances?.[i] ? ellipse(pole, covariances[i]) : null;
    found.push({ ...pole, outline });
    if (pole.imag) found.push({ ...pole, imag: -pole.imag, outline: outline?.map(([x, y]) => [x, -y]) });
  });
  return found;
}

export function splane(room) {
  const picture = shape("svg", { role: "img", "aria-label": "Poles and zeros in the s-plane" });
  room.append(picture);
  const across = steady(0.02, 0.5), up = steady(0.02, 0.5);
  let last = null;

  const draw = view => {
    last = view;
    const width = room.clientWidth, height = room.clientHeight;
    if (!width || !height) return;
    const poles = both(view.poles ?? [], view.pole_covariance), zeros = both(view.zeros ?? []);
    const truth = both(view.truth?.poles ?? []);
    const reach = Math.max(...poles.map(p => Math.hypot(p.real, p.imag)), 0) || 1;
    const near = zeros.filter(zero => Math.hypot(zero.real, zero.imag) <= 5 * reach); // one far out would hide the poles
    const all = [...poles, ...near], xs = all.map(p => p.real), ys = all.map(p => Math.abs(p.imag));
    const [left, right] = across(Math.min(0, ...xs) * 1.3 - 0.02 * reach, Math.max(0.3 * Math.abs(Math.min(0, ...xs)), 1.3 * Math.max(0, ...xs), 0.02 * reach));
    const tall = Math.max(1.45 * Math.max(0, ...ys), 0.35 * reach), [bottom, top] = up(-tall, tall);
    const x = value => EDGE.left + ((value - left) / (right - left)) * (width - EDGE.left - EDGE.right);
    const y = value => EDGE.top + ((top - value) / (top - bottom)) * (height - EDGE.top - EDGE.bottom);
    picture.setAttribute("viewBox", `0 0 ${width} ${height}`);
    picture.replaceChildren(
      ...grid(x, y, [left, right, bottom, top], width, height),
      ...poles.filter(p => p.outline).map(p => tinted(p, shape("polygon", { class: "ellipse", points: p.outline.map(([a, b]) => `${x(a).toFixed(1)},${y(b).toFixed(1)}`).join(" ") }))),
      ...near.map(p => tinted(p, shape("circle", { class: "zero", cx: x(p.real), cy: y(p.imag), r: 5 }))),
      ...poles.map(p => tinted(p, shape("path", { class: p.real > 0 ? "pole unstable" : "pole", d: `M${x(p.real) - 5} ${y(p.imag) - 5}l10 10m0-10l-10 10` }))),
    );
    picture.append(...truth.map(p => shape("path", { class: "true", d: `M${x(p.real) - 7} ${y(p.imag)}l7 -7l7 7l-7 7z` })));
    const hidden = zeros.length - near.length;
    if (hidden) picture.append(shape("text", { x: width - EDGE.right, y: height - EDGE.bottom - 6, "text-anchor": "end" }, `zero far out, at ${number(zeros.find(z => !near.includes(z)).real, 3)}`));
    picture.setAttribute("aria-label", "Poles in the s-plane: " + (poles.map(p => `${number(p.real, 3)}${p.imag ? ` ${p.imag < 0 ? "−" : "+"} ${number(Math.abs(p.imag), 3)}i` : ""}`).join(", ") || "none yet"));
  };
  new ResizeObserver(() => last && draw(last)).observe(room);
  return { draw };
}

/** Whether a box is free of those before it, to which it is then added; [left, top, width] of a text of one line. */
function places() {
  const taken = [];
  return (left, top, width) => {
    const free = taken.every(([l, t, w]) => left > l + w + 4 || l > left + width + 4 || Math.abs(top - t) > 15);
    if (free) taken.push([left, top, width]);
    return free;
  };
}

const LETTER = 6.6, DIGIT = 8.1; // pixels, of the labels; of digits in the widest of the fonts

function grid(x, y, [left, right, bottom, top], width, height) {
  const floor = height - EDGE.bottom, found = [], free = places();
  found.push(shape("rect", { class: "unstable-half", x: x(0), y: EDGE.top, width: Math.max(0, x(right) - x(0)), height: floor - EDGE.top }));
  for (const value of ticks(left, right, width / 70)) {
    found.push(shape("line", { class: value ? "line" : "axis", x1: x(value), x2: x(value), y1: EDGE.top, y2: floor }));
    const label = tick(value), half = (DIGIT * label.length) / 2; // not beyond the frame: it would cut the sign off
    found.push(shape("text", { x: Math.min(Math.max(x(value), half), width - half), y: height - 5, "text-anchor": "middle" }, label));
  }
  for (const value of ticks(bottom, top, Math.max(4, height / 50))) {
    found.push(shape("line", { class: value ? "line" : "axis", x1: EDGE.left, x2: width - EDGE.right, y1: y(value), y2: y(value) }));
    if (!value) continue;
    const label = `${tick(value)}i`;
    free(width - EDGE.right - 2 - LETTER * label.length, y(value) - 3, LETTER * label.length);
    found.push(shape("text", { x: width - EDGE.right - 2, y: y(value) - 3, "text-anchor": "end" }, label));
  }
  for (const damping of DAMPINGS) { // from the origin outwards to the frame
    const slope = Math.sqrt(1 - damping ** 2) / damping, far = Math.min(-left, top / slope), down = Math.min(-left, -bottom / slope);
    found.push(shape("line", { class: "ray", x1: x(0), y1: y(0), x2: x(-far), y2: y(far * slope) }));
    found.push(shape("line", { class: "ray", x1: x(0), y1: y(0), x2: x(-down), y2: y(-down * slope) }));
    const label = `ζ ${damping}`, wide = LETTER * label.length, level = Math.max(y(far * slope) + 4, EDGE.top + 10);
    const across = Math.min(x(-far) + 3, x(0) - 3 - wide); // left of the axis
    if (level < y(0) - 6 && free(across, level, wide)) found.push(shape("text", { class: "damping", x: across, y: level }, label));
  }
  return found;
}
