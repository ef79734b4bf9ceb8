"""The published outcomes of both fingers of the thesis, judged jointly: data, predictors, judgement, page."""
