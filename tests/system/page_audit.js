// What a screen reader's user and a reader with weak eyes would complain of, as a list of sentences.
() => {
  const complaints = [];
  const shown = (element) => element.checkVisibility({ visibilityProperty: true }) && element.getClientRects().length > 0;
  const name = (element) =>
    element.getAttribute("aria-label") || element.closest("label")?.innerText || element.innerText || element.alt || "";

  for (const element of document.querySelectorAll("button, input, select, a, summary, [tabindex], canvas, img")) {
    if (shown(element) && !name(element).trim()) complaints.push(`${element.tagName} #${element.id} has no name`);
  }
  for (const group of document.querySelectorAll("fieldset")) {
    if (!group.querySelector("legend")?.innerText.trim()) complaints.push(`fieldset #${group.id} has no legend`);
  }
  if (!document.documentElement.lang) complaints.push("the page has no language");
  if (document.querySelectorAll("main").length !== 1) complaints.push("expected one main");
  if (document.querySelectorAll("h1").length !== 1) complaints.push("expected one h1");
  const ids = [...document.querySelectorAll("[id]")].map((element) => element.id);
  for (const id of ids) if (ids.indexOf(id) !== ids.lastIndexOf(id)) complaints.push(`id ${id} is there twice`);

  // Contrast, WCAG 2.2, 1.4.3.
  const rgba = (text) => text.match(/[\d.]+/g).map(Number);
  const over = ([r, g, b, a = 1], below) => [r, g, b].map((each, i) => each * a + below[i] * (1 - a));
  const background = (element) => {
    const chain = [];
    for (let each = element; each; each = each.parentElement) chain.unshift(rgba(getComputedStyle(each).backgroundColor));
    return chain.reduce((below, colour) => over(colour, below), [255, 255, 255]);
  };
  const luminance = (colour) => {
    const [r, g, b] = colour.map((each) => each / 255).map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  for (const element of document.querySelectorAll("body *")) {
    const own = [...element.childNodes].some((node) => node.nodeType === Node.TEXT_NODE && node.data.trim());
    if (!own || !shown(element) || element.closest(".unseen, script, option")) continue;
    const style = getComputedStyle(element);
    const below = background(element);
    const [light, dark] = [luminance(over(rgba(style.color), below)), luminance(below)].sort((a, b) => b - a);
    const ratio = (light + 0.05) / (dark + 0.05);
    const large = parseFloat(style.fontSize) >= 24 || (parseFloat(style.fontSize) >= 18.66 && style.fontWeight >= 700);
    if (ratio < (large ? 3 : 4.5)) {
      complaints.push(`contrast ${ratio.toFixed(2)} of "${element.innerText.slice(0, 30)}" (${element.tagName} ${element.className})`);
    }
  }

  // Nothing may be cut off at the side, and what is pressed must be large enough for a finger.
  if (document.documentElement.scrollWidth > innerWidth) complaints.push("the page is wider than the screen");
  for (const button of document.querySelectorAll("button")) {
    if (!shown(button)) continue;
    const { width, height, right, bottom } = button.getBoundingClientRect();
    if (Math.min(width, height) < 40) complaints.push(`${button.id} is ${width} x ${height} px`);
    if (right > innerWidth || bottom > innerHeight) complaints.push(`${button.id} is not in view`);
    if (button.scrollWidth > button.clientWidth) complaints.push(`${button.id}'s text is cut off`);
  }
  return complaints;
}
