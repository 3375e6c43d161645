"""What is checked beside the search for causes: the policy's contract, the depth camera, and footholds in a scene."""
