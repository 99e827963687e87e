"""Boosting: AdaBoost over stumps (chapter 4 of the loop-closure text) and gradient boosting."""
