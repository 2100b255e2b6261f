"""Camera interface, the Aravis adapter (GigE Vision, USB3 Vision), and replay of a folder of images."""
