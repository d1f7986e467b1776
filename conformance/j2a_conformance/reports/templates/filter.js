"use strict";
const form = document.querySelector(".filter");
if (form) {
  const cases = [...document.querySelectorAll(".case")];
  const words = form.querySelector("input[type=search]");
  const boxes = [...form.querySelectorAll("input[type=checkbox]")];
  const shown = form.querySelector("output");
  const apply = () => {
    const wanted = words.value.toLowerCase().split(/\s+/);
    const verdicts = new Set(boxes.filter((box) => box.checked).map((box) => box.value));
    for (const entry of cases) {
      const text = entry.dataset.words;
      entry.hidden = !verdicts.has(entry.dataset.verdict) || !wanted.every((word) => text.includes(word));
    }
    for (const group of document.querySelectorAll(".group")) {
      group.hidden = !group.querySelector(".case:not([hidden])");
    }
    shown.value = `${cases.filter((entry) => !entry.hidden).length} of ${cases.length} cases`;
  };
  form.addEventListener("input", apply);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.querySelector("button").addEventListener("click", () => {
    const visible = cases.filter((entry) => !entry.hidden);
    const open = !visible.every((entry) => entry.open);
    for (const entry of visible) entry.open = open;
  });
  form.hidden = false;
  apply();
}
