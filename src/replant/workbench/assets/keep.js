// What is kept of a model: the command and the program that make it again, its file, a report, and a picture of the plots.
import { at, download, say, send, state, write } from "./page.js";
import { chosen } from "./models.js";

const card = () => state.session?.cards.find(each => each.name === chosen()) ?? state.session?.cards.at(-1) ?? null;

export function drawKeep() {
  const found = card();
  at("keep").hidden = !found;
  if (!found) return;
  const form = document.querySelector("[name=form]:checked").value;
  write(at("which"), found.title);
  write(at("code"), found[form]);
  at("code").dataset.form = form;
  const done = found.state === "done";
  at("save-model").toggleAttribute("aria-disabled", !done);
  if (done) at("save-model").href = `/models/${found.name}/model.json`;
  else at("save-model").removeAttribute("href");
  at("save-report").disabled = !done || at("save-report").dataset.busy === "yes";
}

for (const form of document.querySelectorAll("[name=form]")) form.addEventListener("change", drawKeep);

at("copy").addEventListener("click", async () => {
  const text = at("code").textContent;
  try {
    await navigator.clipboard.writeText(text);
  } catch { // a page that is not on this machine may not: what is marked can be copied by hand
    getSelection().selectAllChildren(at("code"));
    if (!document.execCommand("copy")) { say("The browser does not let the page copy: the text is marked, press Ctrl+C."); return; }
    getSelection().removeAllRanges();
  }
  write(at("copy"), "Copied");
  setTimeout(() => write(at("copy"), "Copy"), 1500);
});

at("save-report").addEventListener("click", async () => {
  const found = card();
  at("save-report").dataset.busy = "yes";
  write(at("save-report"), "Writing…");
  drawKeep();
  const answer = await send(`/models/${found.name}/report`);
  if (answer) download(await answer.blob(), "report.html");
  at("save-report").dataset.busy = "";
  write(at("save-report"), "Report");
  drawKeep();
});

// --- a picture of all plots of the comparison ---
const GAP = 14, HEAD = 22; // pixels between the plots, and for their titles

/** Draw what an svg shows onto a canvas, with the colours that the page has now. */
function drawShapes(context, svg) {
  for (const shape of svg.querySelectorAll("*")) {
    const look = getComputedStyle(shape), number = name => Number(shape.getAttribute(name)), path = new Path2D();
    if (shape.tagName === "text") {
      Object.assign(context, { fillStyle: look.fill, font: "12px sans-serif", textAlign: { middle: "center", end: "right" }[shape.getAttribute("text-anchor")] ?? "left" });
      context.fillText(shape.textContent, number("x"), number("y"));
      continue;
    }
    if (shape.tagName === "rect") path.rect(number("x"), number("y"), number("width"), number("height"));
    else if (shape.tagName === "circle") path.arc(number("cx"), number("cy"), number("r"), 0, 7);
    else if (shape.tagName === "line") { path.moveTo(number("x1"), number("y1")); path.lineTo(number("x2"), number("y2")); }
    else if (shape.tagName === "polygon") path.addPath(new Path2D(`M${shape.getAttribute("points").replaceAll(" ", "L")}Z`));
    else path.addPath(new Path2D(shape.getAttribute("d")));
    if (look.fill !== "none") { context.globalAlpha = Number(look.fillOpacity); context.fillStyle = look.fill; if (shape.tagName !== "line" && shape.tagName !== "path") context.fill(path); }
    if (look.stroke !== "none") { context.globalAlpha = Number(look.strokeOpacity); Object.assign(context, { strokeStyle: look.stroke, lineWidth: parseFloat(look.strokeWidth) }); context.stroke(path); }
    context.globalAlpha = 1;
  }
}

at("picture").addEventListener("click", () => {
  const room = document.querySelector(".compare .figures"), box = room.getBoundingClientRect(), ratio = devicePixelRatio || 1;
  const style = getComputedStyle(document.documentElement), ink = style.getPropertyValue("--ink"), head = HEAD * (1 + state.session.shown.length);
  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width: (box.width + 2 * GAP) * ratio, height: (box.height + head + 2 * GAP) * ratio });
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  context.fillStyle = style.getPropertyValue("--page");
  context.fillRect(0, 0, canvas.width, canvas.height);
  let y = GAP + 12;
  for (const row of document.querySelectorAll("#verdicts summary")) {
    context.fillStyle = getComputedStyle(row.querySelector(".tint")).backgroundColor;
    context.fillRect(GAP, y - 6, 14, 4);
    Object.assign(context, { fillStyle: ink, font: "600 13px sans-serif", textAlign: "left" });
    context.fillText([".who", "b", ".word"].map(name => row.querySelector(name).textContent).join("   "), GAP + 22, y);
    y += HEAD;
  }
  const place = element => { const at = element.getBoundingClientRect(); return [at.left - box.left + GAP, at.top - box.top + head]; };
  for (const figure of room.querySelectorAll("figure")) {
    const [x, top] = place(figure.querySelector("h2"));
    Object.assign(context, { fillStyle: ink, font: "600 13px sans-serif", textAlign: "left" });
    context.fillText(figure.querySelector("h2").textContent, x, top + 14);
    for (const drawn of figure.querySelectorAll("canvas")) { const at = drawn.getBoundingClientRect(); context.drawImage(drawn, ...place(drawn), at.width, at.height); }
    for (const svg of figure.querySelectorAll("svg")) { const [left, up] = place(svg); context.save(); context.translate(left, up); drawShapes(context, svg); context.restore(); }
  }
  canvas.toBlob(blob => download(blob, "comparison.png"), "image/png");
});
