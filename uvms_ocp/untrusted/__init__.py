"""In: files that anyone may have written. Out: plain values within bounds, or one line that says what is wrong."""
