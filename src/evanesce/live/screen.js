// Content that changes with every picture is set directly, without the page's model, which would compare all elements
// of the page.
export default {
  template: `<div hidden></div>`,
  methods: {
    // parts: [selector, what, value]; what: "html", "text", "value" (of a field without focus) or an attribute
    show(parts) {
      for (const [selector, what, value] of parts) {
        const element = document.querySelector(selector);
        if (!element) continue;
        if (what === "html") element.innerHTML = value;
        else if (what === "text") element.textContent = value;
        else if (what === "value") {
          if (element !== document.activeElement) element.value = value;
        } else element.setAttribute(what, value);
      }
    },
  },
};
