"""The paper's 23-term Taylor (Abkowitz) series: samples by the paper's pipeline or a smoother, regression, file."""
