#include "dfr/sim/mujoco/mujoco_model.h"

#include <mujoco/mujoco.h>

#include <mutex>
#include <stdexcept>

namespace dfr::sim {

void MjDeleter::operator()(mjModel* model) const noexcept { mj_deleteModel(model); }
void MjDeleter::operator()(mjData* data) const noexcept { mj_deleteData(data); }

MjModelPtr LoadMujocoModel(std::string_view xml, const std::string& name) {
  // The compiled header and the library found at run time must agree on every struct.
  if (mj_version() != mjVERSION_HEADER) {
    throw std::runtime_error("MuJoCo " + std::string(mj_versionString()) +
                             " was found at run time, but this program was built against version " +
                             std::to_string(mjVERSION_HEADER) + "; install libmujoco2.2.2");
  }
  static std::mutex mutex;  // mj_loadXML() keeps the last model in a global
  const std::lock_guard lock(mutex);
  const auto vfs = std::make_unique<mjVFS>();
  mj_defaultVFS(vfs.get());
  mj_makeEmptyFileVFS(vfs.get(), "model.xml", static_cast<int>(xml.size()));
  xml.copy(static_cast<char*>(vfs->filedata[mj_findFileVFS(vfs.get(), "model.xml")]), xml.size());
  char error[512] = "";
  MjModelPtr model(mj_loadXML("model.xml", vfs.get(), error, sizeof error));
  mj_deleteVFS(vfs.get());
  if (model == nullptr) throw std::runtime_error(name + " model: " + error);
  return model;
}

int MujocoId(const mjModel& model, int type, const std::string& name) {
  const int id = mj_name2id(&model, type, name.c_str());
  if (id < 0) throw std::runtime_error("the MuJoCo model has no object '" + name + "'");
  return id;
}

}  // namespace dfr::sim
