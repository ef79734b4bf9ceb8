// The browser's own slider, with its role, focus, and arrow, Page, Home and End keys. It stores its value and emits
// "moved" with each new one: a model would have the whole page rendered at every step.
export default {
  template: `<input type="range" :min="min" :max="max" :step="step" :value="held" @input="moved" />`,
  props: { min: Number, max: Number, step: Number, start: Number },
  emits: ["moved"],
  data() {
    return { held: this.start };
  },
  methods: {
    moved(event) {
      this.held = Number(event.target.value);
      this.$emit("moved", this.held);
    },
    put(value) {
      this.held = value;
    },
  },
};
