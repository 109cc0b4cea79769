// The shape of a verdict, which tells its gravity without its colour.

const SIGNS = {
  good: "M12 1a11 11 0 1 0 0 22a11 11 0 1 0 0-22z|M6.5 12.5l3.7 3.7 7.3-8",
  warn: "M12 1.5L23.5 22H.5z|M12 9v6M12 18v.6",
  bad: "M7.4 1h9.2L23 7.4v9.2L16.6 23H7.4L1 16.6V7.4z|M8 8l8 8M16 8l-8 8",
  none: "M12 1L23 12L12 23L1 12z|M7.5 12h.1M12 12h.1M16.5 12h.1",
};

/** Draw the sign of a gravity into an svg of 24 by 24. */
export function drawSign(svg, gravity) {
  svg.replaceChildren(...SIGNS[gravity].split("|").map((d, i) => {
    const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
    path.setAttribute("d", d);
    if (i) path.setAttribute("class", "mark");
    return path;
  }));
}
