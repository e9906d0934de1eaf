"""How fast is the client? The controller alone, beside others on the same problem, and the whole loop."""
