"""Networks: torsos, dueling heads, and their NumPy twins."""
