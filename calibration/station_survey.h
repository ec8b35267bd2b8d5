#pragma once

#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "calibration/board_pose.h"
#include "calibration/camera_model.h"
#include "calibration/target.h"
#include "planning/pose2.h"

namespace tagdock {

/// Tags seen in one picture: corners by tag id, in the order of `Corners`, with their sigma.
struct TagView {
  std::string name;
  struct Tag {
    int id = 0;
    Corners corners_px;
    double sigma_px = 0.1;
  };
  std::vector<Tag> tags;
};

/// A board whose tags were measured against each other.
struct BoardSurvey {
  Board board;  ///< the reference tag stands as in the board given; the others where the views put them
  struct Moved {
    int id = 0;
    double offset_mm = 0.0;  ///< against the board given
    double angle_deg = 0.0;
    double sigma_mm = 0.0;  ///< of the place, one sigma
    double sigma_deg = 0.0;
    int views = 0;
    double rms_px = 0.0;  ///< that its corners leave
  };
  std::vector<Moved> tags;      ///< all but the reference
  double wing_angle_deg = 0.0;  ///< between the first and the last tag's normals
  double rms_px = 0.0;          ///< that all corners leave, per coordinate
  double over_claimed = 0.0;    ///< the same over what the corners' sigmas promise; near 1 when nothing is wrong
  struct Left {
    std::string name;
    double rms_px = 0.0;
  };
  std::vector<Left> pictures;           ///< that were used
  std::vector<std::string> complaints;  ///< numbers and what to do; empty if good
};

/// How the tags of a board really stand to each other, from pictures that show two or more of them: all poses at once
/// (Ceres), the reference tag held where the board given has it. Corners that leave more than they should are
/// complained of, with the picture or tag that leaves most: a wrong camera file, size or print leaves much everywhere,
/// a picture in which something moved leaves much alone. Throws std::invalid_argument if no picture shows the reference
/// tag with another one.
BoardSurvey survey_board(const std::vector<TagView>& views, const Board& board, const CameraModel& camera,
                         int reference_id);

/// Teach-in: the docking pose as the mean of some dockings by hand.
struct Taught {
  Pose2 mean;    ///< of the camera point in the station frame
  Pose2 spread;  ///< standard deviation of one
  std::vector<std::size_t> outliers;
  std::vector<std::string> complaints;
};
Taught teach_in(const std::vector<Pose2>& poses);

}  // namespace tagdock
