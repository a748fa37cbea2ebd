"""One small light in the images of several cameras: images to tracks."""
