// The verdict: a sentence, a colour and a shape; its reasons in a place of fixed height, which a button opens.
import { at, drawSign, write } from "./served.js";
import { VERDICTS } from "./words.js";

// shown instead of the verdict while no views arrive: the last verdict was about the past
const APART = {
  over: ["The session has ended", "The page shows its last estimate, which is no longer judged."],
  silent: ["The session does not answer", "The page shows its last estimate, which is not judged at present."],
  lost: ["Not connected", "The page shows the last estimate received, which is not judged at present."],
};

const RESTS = "The input moves too little now: nothing can be learned.";

const sentence = text => (text ? text[0].toUpperCase() + text.slice(1).replace(/\.?$/, ".") : "");

/** Draw the verdict of a view; apart: why the page shows the past, see `APART`. */
export function drawVerdict(view, apart) {
  let [gravity, headline, meaning] = VERDICTS.get(view.verdict) ?? ["warn", sentence(view.verdict).replace(/\.$/, ""), ""];
  if (view.verdict === "trusted" && !view.excited) meaning += ` ${RESTS}`; // right as far as is known, and not tested now
  if (view.status === "starting") {
    [gravity, headline, meaning] = ["none", "Collecting the first samples", view.den?.length
      ? "The model shown is provisional: it is made from few samples and tested on none."
      : "The first model is estimated when there are enough samples."];
  }
  if (apart) [gravity, headline, meaning] = ["none", APART[apart][0], `${APART[apart][1]} The last verdict was: ${headline.toLowerCase()}.`];
  const box = document.querySelector(".verdict");
  if (box.dataset.gravity !== gravity || !box.querySelector("path")) {
    box.dataset.gravity = gravity;
    drawSign(box.querySelector("svg"), gravity);
  }
  write(at("headline"), headline);
  write(at("meaning"), meaning);
  write(at("announced"), `Verdict: ${headline}. ${meaning}`); // read aloud when it changes, unlike the figures below
  const list = at("reasons"), reasons = view.reasons.map(sentence);
  while (list.children.length > reasons.length) list.lastChild.remove();
  reasons.forEach((text, i) => write(list.children[i] ?? list.appendChild(document.createElement("li")), text));
  fitReasons();
}

/** Show the button only where reasons are cut off, or all are shown. */
function fitReasons() {
  const box = document.querySelector(".verdict"), opened = box.classList.contains("open"), frame = getComputedStyle(box);
  const cut = !opened && at("words").scrollHeight > box.clientHeight - parseFloat(frame.paddingTop) - parseFloat(frame.paddingBottom) + 1;
  box.classList.toggle("cut", cut);
  at("more").hidden = !opened && !cut;
}

at("more").addEventListener("click", () => {
  const opened = document.querySelector(".verdict").classList.toggle("open");
  write(at("more"), opened ? "Fewer reasons" : "All reasons");
  at("more").setAttribute("aria-expanded", String(opened));
  fitReasons();
});
new ResizeObserver(fitReasons).observe(at("words"));
