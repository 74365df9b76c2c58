"""A trained policy as files for use elsewhere: ONNX, deploy.yaml, the robot, and scripts."""
