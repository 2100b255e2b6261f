"""Live sources of images: a folder that is filled, a picture by HTTP, a stream by RTSP."""
