// The browser's own slider: it has a role, takes focus, and knows arrows, Page, Home and End by itself.
export default {
  template: `<input type="range" :min="min" :max="max" :step="step" :value="modelValue" @input="moved" />`,
  props: { min: Number, max: Number, step: Number, modelValue: Number, loopback: Boolean },
  emits: ["update:modelValue"],
  methods: {
    moved(event) {
      this.$emit("update:modelValue", Number(event.target.value));
    },
  },
};
