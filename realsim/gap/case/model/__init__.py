"""What effects change: the robot as one log knows it, and its model and sensors as they are edited."""
