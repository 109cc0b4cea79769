// Of several inputs the one whose G(s), poles and responses are shown: a button for each.
import { element } from "./served.js";

/** The buttons of a toolbar, which is hidden where there is one input, choose it. */
export function inputChoice(bar, changed) {
  let chosen = 0;
  const press = () => [...bar.querySelectorAll("button")].forEach((button, i) => button.setAttribute("aria-pressed", String(i === chosen)));
  const build = names => {
    chosen = 0;
    bar.dataset.names = names.join("\n");
    bar.querySelectorAll("button").forEach(button => button.remove());
    names.forEach((name, i) => {
      bar.append(element("button", { type: "button", onclick: () => { chosen = i; press(); changed(); } }, name));
    });
    press();
  };
  return {
    /** The view as it is of one input, the chosen one. */
    of(view) {
      const inputs = [view, ...(view.more_inputs ?? [])], names = inputs.map(each => each.input_label ?? "");
      bar.hidden = inputs.length < 2;
      if (names.join("\n") !== bar.dataset.names) build(names);
      return { ...view, ...inputs[chosen] };
    },
  };
}
