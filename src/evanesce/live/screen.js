// What changes with every picture is put in its place directly, past the page's model: that would compare all elements
// of the page for a few that are known to have changed.
export default {
  template: `<div hidden></div>`,
  methods: {
    // parts: [selector, what, value]; what: "html", "text", "value" (of a field nobody is typing in) or an attribute
    show(parts) {
      for (const [selector, what, value] of parts) {
        const place = document.querySelector(selector);
        if (!place) continue;
        if (what === "html") place.innerHTML = value;
        else if (what === "text") place.textContent = value;
        else if (what === "value") {
          if (place !== document.activeElement) place.value = value;
        } else place.setAttribute(what, value);
      }
    },
  },
};
