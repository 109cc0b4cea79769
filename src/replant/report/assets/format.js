// Numbers and names as text.

const SUPER = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹", SUB = "₀₁₂₃₄₅₆₇₈₉";
export const NONE = "–";

export const known = value => typeof value === "number" && Number.isFinite(value);
const signed = text => text.replace("-", "−");
export const superscript = n => String(n).replace(/[-0-9]/g, c => SUPER["-0123456789".indexOf(c)]);

/** A name with its number as subscript: a1 to a₁, a1.Q1 to a₁.Q1. */
export const lowered = name => name.replace(/\d+(?=$|\.)/, digits => digits.replace(/\d/g, d => SUB[d]));

/** Mantissa and power of ten of a number with that many digits; power 0 for a number of moderate size. */
export function parts(value, digits = 4) {
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e6)) {
    const [mantissa, power] = value.toExponential(digits - 1).split("e");
    return [signed(mantissa), +power];
  }
  const whole = size >= 10 ** (digits - 1);
  return [signed(whole ? value.toFixed(0) : value.toPrecision(digits)), 0];
}

export function number(value, digits = 4) {
  if (!known(value)) return NONE;
  const [mantissa, power] = parts(value, digits);
  return power ? `${mantissa}×10${superscript(power)}` : mantissa;
}

/** A tick's label: no more digits than it needs. */
export function tick(value, digits = 9) {
  if (!known(value)) return NONE;
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e6)) {
    const [mantissa, power] = value.toExponential(Math.min(digits, 4) - 1).split("e");
    return signed(String(+mantissa)) + "×10" + superscript(+power);
  }
  return signed(String(+value.toPrecision(digits)));
}

/** Number of decimal places that show two digits of the standard deviation. */
const places = std => Math.max(0, 1 - Math.floor(Math.log10(std)));

/** Value and, in small, its standard deviation: both to the same place. */
export function uncertain(value, std, digits = 4) {
  if (!known(value)) return [NONE, ""];
  const size = Math.max(Math.abs(value), std);
  if (!known(std) || std <= 0 || size >= 1e6 || size < 1e-3) {
    return [number(value, digits), known(std) && std > 0 ? "± " + number(std, 2) : ""];
  }
  const after = Math.min(places(std), 9);
  return [signed(value.toFixed(after)), "± " + std.toFixed(after)];
}

/** A whole number with commas between thousands; from WIDE on with a power of ten, to fit its field. */
const WIDE = 1e12;
const whole = value => (Math.abs(value) < WIDE ? Math.round(value).toLocaleString("en") : number(value));

export const count = value => (known(value) ? whole(value) : NONE);

export function percent(value) {
  if (!known(value)) return NONE;
  return value < -1000 ? "below −1000 %" : signed(value.toFixed(1)) + " %";
}

/** A part in percent, with two digits. */
export function share(part) {
  if (!known(part)) return NONE;
  if (part >= 10) return "> 1000 %";
  return part < 1e-6 ? "< 0.0001 %" : `${+(100 * part).toPrecision(2)} %`;
}

/** A clock: 12.3 s, 4:05.2, 1:02:03. */
export function clock(seconds) {
  if (!known(seconds)) return NONE;
  if (Math.abs(seconds) >= WIDE) return number(seconds) + " s";
  if (seconds < 60) return seconds.toFixed(1) + " s";
  const [h, m, s] = [Math.floor(seconds / 3600), Math.floor(seconds / 60) % 60, seconds % 60];
  const two = n => String(Math.floor(n)).padStart(2, "0");
  if (!h) return `${m}:${s.toFixed(1).padStart(4, "0")}`.replace(":60.0", ":59.9");
  return `${h.toLocaleString("en")}:${two(m)}:${two(s)}`;
}

/** Labels of a time axis as wide as span: seconds, m:ss or h:mm. */
export function timeLabel(seconds, span) {
  if (span <= 120 || Math.abs(seconds) >= WIDE) return tick(seconds) + " s";
  const total = Math.round(seconds), two = n => String(n).padStart(2, "0");
  if (span <= 7200) return `${Math.floor(total / 60)}:${two(total % 60)}`;
  return `${Math.floor(total / 3600).toLocaleString("en")}:${two(Math.floor(total / 60) % 60)} h`;
}

export function rate(value) {
  if (!known(value)) return NONE;
  if (value >= 1e6) return (value < WIDE ? (value / 1e6).toFixed(2) + " M/s" : number(value) + " /s");
  return (value < 10 ? +value.toPrecision(2) : Math.round(value).toLocaleString("en")) + " /s";
}

export function shortly(seconds) {
  if (!known(seconds)) return NONE;
  if (seconds < 0.9995e-3) return Math.round(seconds * 1e6) + " µs";
  if (seconds < 0.9995) return (seconds * 1e3).toPrecision(seconds < 0.0995 ? 2 : 3) + " ms";
  return (seconds < 1e6 ? seconds.toFixed(1) : number(seconds)) + " s";
}
