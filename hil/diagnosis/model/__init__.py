"""The diagnosis as one generative model, one evidence, one search (`hil/docs/model.md` has the formulas)."""
