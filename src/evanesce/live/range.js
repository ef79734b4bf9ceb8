// The browser's own slider: it has a role, takes focus, and knows arrows, Page, Home and End by itself. It holds its
// value itself and tells each new one as "moved": a model would have the whole page rendered anew at every step.
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
