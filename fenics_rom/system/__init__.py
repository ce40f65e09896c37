"""The full-order model as the reduction sees it, whoever assembled it."""
