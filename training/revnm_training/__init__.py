"""Learning by synthesis: data, networks, training loops and the export to ONNX. The only package with torch."""
