// Search over the pages of the documentation: those that have every word, the words of their titles first.
const asked = document.getElementById("search"), found = document.getElementById("found");
asked.addEventListener("input", () => {
  const words = asked.value.toLowerCase().split(/\s+/).filter((word) => word.length > 1);
  const has = (text) => words.filter((word) => text.toLowerCase().includes(word)).length;
  const fitting = words.length ? PAGES.filter(([title, , text]) => has(`${title} ${text}`) === words.length) : [];
  fitting.sort((one, other) => has(other[0]) - has(one[0]));
  found.replaceChildren(...fitting.slice(0, 12).map(([title, href, text]) => {
    const item = document.createElement("li"), link = document.createElement("a");
    const at = Math.max(0, text.toLowerCase().indexOf(words[0]) - 40);
    link.href = asked.dataset.top + href;
    link.textContent = title;
    item.append(link, ` … ${text.slice(at, at + 120)} …`);
    return item;
  }));
});
